"""Writes a run as one HTML file of template, style, program, scene and numbers."""

import base64
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from tg4mm.capture import load_capture
from tg4mm.capture.model import Capture
from tg4mm.core import __version__
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.files import write_atomic
from tg4mm.core.phasors import peak_displacement
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.show.maps import blending_weights, image_motion, middle_depth
from tg4mm.show.render.cameras import Camera, capture_cameras
from tg4mm.show.result.model import title_of, unit_of
from tg4mm.show.result.read import peak_bands, result_from
from tg4mm.show.result.reading import reading_of
from tg4mm.show.web.pack import MotionFields, Packed, motion_fields, pack, packed_within

_HERE = Path(__file__).parent
_PLAYER = _HERE / "player" / "dist"
_SUFFIXES = (".html", ".htm")
_NUMBERS = 200_000  # bytes of style, cameras and temporal components
FORMAT_VERSION = 1


@dataclass(frozen=True)
class PageValues:
    """The values of the page's template."""

    scene: dict[str, Any]
    block: bytes
    regions: bytes = b""  # PNG: which part is which sensor


def export_html(run: Run, out: Path, most_bytes: int | None = None, regions: Path | None = None) -> Path:
    """Write the run as one page that plays in a browser, from the file alone (docs/web.md).

    most_bytes: of the file, where the whole scene would be larger (`pack.py` says what is left out); None: any size.
    regions: a PNG that shows which part is which sensor, for the panel. A run without motion gives a page of the still
    scene. Raises Tg4mmError for an `out` that is a folder, or a file that is no page; RunError for a run without a
    space stage or whose dataset is gone; CaptureError for a bad one.
    """
    if out.is_dir():
        raise Tg4mmError(f"--out {out}: is a folder; expected a file such as {out / 'scene.html'}")
    if out.suffix.lower() not in _SUFFIXES:
        raise Tg4mmError(f"--out {out}: expected a name that ends in .html, as browsers need it")
    text = render(make_page(run, most_bytes, regions))
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return out


def make_page(run: Run, most_bytes: int | None = None, regions: Path | None = None) -> PageValues:
    """Return the scene and its arrays, at most as large as the page may be. Raises the errors of `export_html`."""
    shown = b"" if regions is None else regions.read_bytes()
    with progress("page", 4, unit="steps") as update:
        gaussians, motion = run.load_space(), run.load_motion()
        update(1)
        fields = _fields(motion, len(gaussians))
        update(2)
        light = None if motion is None else motion.appearance
        if most_bytes is None:
            packed = pack(gaussians, fields, light)
        else:
            most = int(0.75 * (most_bytes - _own_bytes()) - len(shown))  # base64 takes four bytes for three
            weights = blending_weights(gaussians, load_capture(run.dataset))
            packed = packed_within(gaussians, fields, light, weights, most)
        update(3)
        scene = scene_json(run, gaussians, motion, fields, packed)
        update(4)
    return PageValues(scene, packed.block, shown)


def _own_bytes() -> int:
    """Return the approximate size of a page without its block: program, style, numbers."""
    return _NUMBERS + sum((_PLAYER / name).stat().st_size for name in ("player.js", "licences.txt"))


def _fields(motion: ModalMotion | None, n: int) -> MotionFields:
    if motion is None or not len(motion.freqs_hz):
        return MotionFields(np.zeros((0, n, 6), np.float32), np.zeros((0, 2)), np.zeros((0, 0), complex))
    return motion_fields(motion)


def render(page: PageValues) -> str:
    """Return the page as text. Its content security policy allows no connections and only its program."""
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    program = (_PLAYER / "player.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
    digest = base64.b64encode(hashlib.sha256(program.encode()).digest()).decode()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("page.html").render(
        title=page.scene["title"],
        version=__version__,
        style=Markup(style),
        program=Markup(program),
        program_hash=Markup(f"sha256-{digest}"),
        licences=(_PLAYER / "licences.txt").read_text(encoding="utf-8"),
        # Only "<" could end a script element; JSON reads \u003c as the same text.
        scene=Markup(json.dumps(page.scene, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")),
        block=Markup(base64.b64encode(page.block).decode("ascii")),
        regions=Markup(base64.b64encode(page.regions).decode("ascii")),
    )


def camera_json(camera: Camera) -> dict[str, Any]:
    """Return a camera for the page: {name, width, height, K, viewmat}, docs/conventions.md."""
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "K": np.asarray(camera.K).tolist(),
        "viewmat": np.asarray(camera.viewmat).tolist(),
    }


def scene_json(
    run: Run, gaussians: Gaussians, motion: ModalMotion | None, fields: MotionFields, packed: Packed
) -> dict[str, Any]:
    """Return everything but the Gaussians' arrays.

    Raises CaptureError for a bad dataset, RunError where it is gone: the page opens with a camera of it.
    """
    if not run.dataset.is_dir():
        raise RunError(f"{run.dataset}: the run's dataset is missing; the page opens with one of its cameras")
    capture = load_capture(run.dataset)
    camera, pixels = _first_camera(capture, gaussians, motion)
    unit, factor = unit_of(capture)
    scene = {
        "format_version": FORMAT_VERSION,
        "title": title_of(capture),
        "length": {"unit": unit, "per_scene_unit": factor},
        "background": [1.0, 1.0, 1.0],
        "layout": packed.layout.as_json(),
        "camera": camera_json(camera),
        "target_depth": middle_depth(
            gaussians.means.cpu().numpy(), gaussians.opacities.cpu().numpy(), camera
        ),
        "motion": None,
    }
    if motion is not None and len(motion.freqs_hz):
        scene["motion"] = _motion_json(run, motion, fields, packed, camera, pixels)
    return scene


def _first_camera(
    capture: Capture, gaussians: Gaussians, motion: ModalMotion | None
) -> tuple[Camera, np.ndarray]:
    """Choose the camera that sees the strongest mode move farthest, among those with most pictures.

    Also returns every mode's rms motion [K] in its picture, in pixels.
    """
    counts = np.bincount(capture.camera_ids)[list(dict.fromkeys(capture.camera_ids.tolist()))]
    cameras = [c for c, n in zip(capture_cameras(capture), counts, strict=True) if n == counts.max()]
    if motion is None or not len(motion.freqs_hz):
        return cameras[0], np.zeros(0)
    weights = gaussians.opacities.cpu().numpy()
    main = int(np.argmax(motion.powers() * motion.is_magnified()))
    seen = [image_motion(gaussians, motion, weights, camera) for camera in cameras]
    best = int(np.argmax([pixels[main] for pixels in seen]))
    return cameras[best], seen[best]


def _motion_json(
    run: Run, motion: ModalMotion, fields: MotionFields, packed: Packed, camera: Camera, pixels: np.ndarray
) -> dict[str, Any]:
    magnified = motion.is_magnified()
    reading = reading_of(run)
    top = float((pixels * magnified).max(initial=0))
    result = result_from(reading)
    alpha = result.alpha if top > 0 else 1.0
    amplitudes = {v.hz: v.amplitude.value for v in result.vibrations}
    light = motion.appearance
    series = {} if light is None else {"light_series": _parts(light.series * packed.light_sizes)}
    return {
        "fps": motion.fps,
        "n_timesteps": motion.n_timesteps,
        "freqs_hz": [float(f) for f in motion.freqs_hz],
        "magnified": [bool(m) for m in magnified],
        "rms_px": [float(p) for p in pixels],
        "amplitude": [_amplitude(motion, k) for k in range(len(motion.freqs_hz))],
        "peaks": [
            {"hz": hz, "band": list(band), "amplitude": amplitudes.get(hz, _nearest(motion, hz))}
            for hz, band in peak_bands(reading)
        ],
        "sizes": fields.sizes.tolist(),
        "series": _parts(fields.series),
        "alpha": alpha,
        "alpha_max": alpha * 5,
        **series,
    }


def _nearest(motion: ModalMotion, hz: float) -> float:
    return _amplitude(motion, int(np.abs(np.asarray(motion.freqs_hz) - hz).argmin()))


def _amplitude(motion: ModalMotion, k: int) -> float:
    """Return the 99th percentile of mode k's displacement, scene units."""
    return float(np.percentile(peak_displacement(motion.displacement_of(k)), 99))


def _parts(values: np.ndarray) -> dict[str, list]:
    return {"re": np.real(values).tolist(), "im": np.imag(values).tolist()}
