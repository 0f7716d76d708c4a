"""What a page says of its scene: JSON that the page's program reads, and a reader of the page can too."""

from __future__ import annotations

from typing import Any

import numpy as np

from tg4mm.capture import load_capture
from tg4mm.capture.model import Capture
from tg4mm.core.errors import RunError
from tg4mm.core.phasors import peak_displacement
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.show.render.cameras import Camera, capture_cameras
from tg4mm.show.report.maps import image_motion
from tg4mm.show.report.summary import title_of
from tg4mm.show.result.read import reading_of
from tg4mm.show.web.factor import MotionFields
from tg4mm.show.web.pack import Packed

FORMAT_VERSION = 1


def camera_json(camera: Camera) -> dict[str, Any]:
    """A camera as the page takes it: {name, width, height, K, viewmat}, docs/conventions.md."""
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
    """Everything but the numbers of the Gaussians.

    Raises CaptureError for a bad dataset, RunError where it is gone: the page opens with a camera of it.
    """
    if not run.dataset.is_dir():
        raise RunError(f"{run.dataset}: the run's dataset is gone; a page opens with one of its cameras")
    capture = load_capture(run.dataset)
    camera, pixels = _first_camera(capture, gaussians, motion)
    scene = {
        "format_version": FORMAT_VERSION,
        "title": title_of(capture),
        "unit_scale_m": capture.unit_scale_m,
        "background": [1.0, 1.0, 1.0],
        "layout": packed.layout.as_json(),
        "camera": camera_json(camera),
        "target_depth": _depth(gaussians, camera),
        "motion": None,
    }
    if motion is not None and len(motion.freqs_hz):
        scene["motion"] = _motion_json(run, motion, fields, packed, camera, pixels)
    return scene


def _first_camera(
    capture: Capture, gaussians: Gaussians, motion: ModalMotion | None
) -> tuple[Camera, np.ndarray]:
    """Of those that took most pictures, the camera that sees the strongest mode move farthest; in its picture, every
    mode's rms motion [K] in pixels."""
    counts = np.bincount(capture.camera_ids)[list(dict.fromkeys(capture.camera_ids.tolist()))]
    cameras = [c for c, n in zip(capture_cameras(capture), counts, strict=True) if n == counts.max()]
    if motion is None or not len(motion.freqs_hz):
        return cameras[0], np.zeros(0)
    weights = gaussians.opacities.cpu().numpy()
    strength = (np.abs(motion.displacement) ** 2).sum(axis=(1, 2)) * motion.is_magnified()
    main = motion.displacement[int(np.argmax(strength))]
    seen = [image_motion(gaussians, main, weights, camera) for camera in cameras]
    best = cameras[int(np.argmax(seen))]
    return best, np.array([image_motion(gaussians, m, weights, best) for m in motion.displacement])


def _depth(gaussians: Gaussians, camera: Camera) -> float:
    """Distance along the optical axis of the point to orbit around: the median of what lies in view, by opacity."""
    points = gaussians.means.cpu().numpy() @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    z = np.maximum(points[:, 2], 1e-9)
    u, v = (camera.K[i, i] * points[:, i] / z + camera.K[i, 2] for i in (0, 1))
    inside = (points[:, 2] > 0.01) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    if not inside.any():
        return 1.0
    order = np.argsort(z[inside])
    sums = np.cumsum(gaussians.opacities.cpu().numpy()[inside][order])
    return float(z[inside][order][np.searchsorted(sums, sums[-1] / 2)])


def _motion_json(
    run: Run, motion: ModalMotion, fields: MotionFields, packed: Packed, camera: Camera, pixels: np.ndarray
) -> dict[str, Any]:
    magnified = motion.is_magnified()
    reading = reading_of(run)
    top = float((pixels * magnified).max(initial=0))
    alpha = reading.result().alpha if top > 0 else 1.0
    light = motion.appearance
    series = {} if light is None else {"light_series": _parts(light.series * packed.light_sizes)}
    return {
        "fps": motion.fps,
        "n_timesteps": motion.n_timesteps,
        "freqs_hz": [float(f) for f in motion.freqs_hz],
        "magnified": [bool(m) for m in magnified],
        "rms_px": [float(p) for p in pixels],
        "amplitude": [_amplitude(m) for m in motion.displacement],
        "peaks_hz": reading.peaks_hz(),
        "sizes": fields.sizes.tolist(),
        "series": _parts(fields.series),
        "alpha": alpha,
        "alpha_max": alpha * 5,
        **series,
    }


def _amplitude(phasors: np.ndarray) -> float:
    """How far the 1 % of Gaussians that move most in a mode [N, 3] move at least, scene units."""
    return float(np.percentile(peak_displacement(phasors), 99))


def _parts(values: np.ndarray) -> dict[str, list]:
    return {"re": np.real(values).tolist(), "im": np.imag(values).tolist()}
