"""Renders a run over time from given cameras; keeps complete pictures and refuses those of other requests."""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tg4mm.core.errors import RunError
from tg4mm.core.files import write_atomic
from tg4mm.core.magnification import AS_CAPTURED, LARGEST_ALPHA, Magnification
from tg4mm.core.pictures import png
from tg4mm.core.pictures.decode import to_bytes, write_png
from tg4mm.core.progress import progress
from tg4mm.core.work_folder import WorkFolder
from tg4mm.fit.gaussians import Gaussians
from tg4mm.run import Run
from tg4mm.run.preset import method_of, poses_of
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.export.lowpass import lacking, smoothing_of
from tg4mm.show.render.cameras import Camera, transforms_json
from tg4mm.show.render.image import WHITE, render_image
from tg4mm.show.render.video import check_rate, video_of, video_of_files

RECORD = "render.json"
FORMAT = "tg4mm-render"
Pose = Callable[[float], Gaussians]  # of a timestep, which may be fractional
Job = tuple[float, Camera, Path]  # timestep, camera, picture


@dataclass(frozen=True)
class RenderRequest:
    """A render request. DIR/render.json records it, so that DIR never has pictures of two requests."""

    magnified: Magnification = AS_CAPTURED
    background: tuple[float, float, float] = WHITE
    slow: float = 1.0  # 2 = videos at half speed
    # widening of drawn Gaussians, square pixels; less if a file's scales include some of it
    low_pass_px2: float = 0.3
    kept: int | None = None  # so many of a video's pictures are written; None: all

    def checked(self) -> "RenderRequest":
        """Return itself. Raises RunError for an alpha or a speed out of range."""
        for alpha in (self.magnified.everywhere, *(b.alpha for b in self.magnified.bands)):
            if not math.isfinite(alpha):
                raise RunError(f"--alpha {alpha:g}: must be a finite number (-1 stops the motion)")
            if abs(alpha) > LARGEST_ALPHA:
                raise RunError(f"--alpha {alpha:g}: must be within ±{LARGEST_ALPHA:g}")
        if not math.isfinite(self.slow) or self.slow <= 0:
            raise RunError(f"--slow {self.slow:g}: must be above 0 (2 = half speed)")
        return self

    @property
    def label(self) -> str:
        """α as progress shows it."""
        chosen = self.magnified
        return ", ".join(f"{b.alpha:g}" for b in chosen.bands) or f"{chosen.everywhere:g}"


def render_sequence(
    run: Run,
    cameras: Sequence[Camera],
    request: RenderRequest,
    out: Path,
    timesteps: Sequence[int] | None = None,
    video: bool = True,
    device: str = "cpu",
) -> Path:
    """Write OUT/<t>/<camera>.png for every timestep (default: all) and camera, and OUT/<camera>.mp4.

    Complete pictures are kept, whatever their device. Raises RunError if OUT has another request, the run has no motion
    but alpha is not 0, or a timestep does not exist.
    """
    pose, n_timesteps, fps = pose_of(run, request, device)
    wanted = list(range(n_timesteps)) if timesteps is None else [int(t) for t in timesteps]
    for t in wanted:
        if not 0 <= t < n_timesteps:
            raise RunError(f"timestep {t} is outside 0 … {n_timesteps - 1}")
    jobs = [(float(t), c, out / f"{t:03d}" / f"{c.name}.png") for t in wanted for c in cameras]
    speed = "" if request.slow == 1 else f"_slow{request.slow:g}"
    videos = {}
    if video and len(wanted) > 1:
        for i, camera in enumerate(cameras):
            videos[f"{camera.name}{speed}.mp4"] = [path for *_, path in jobs[i :: len(cameras)]]
    return _render(run, cameras, request, out, "sequence", jobs, pose, videos, fps / request.slow)


def render_orbit(
    run: Run, cameras: Sequence[Camera], request: RenderRequest, out: Path, device: str = "cpu"
) -> Path:
    """Write OUT/r_000.png …, one per camera, over time, and OUT/orbit.mp4.

    Slow motion has frames in between, since the motion is a function of time: frame i shows the time i / slow at the
    capture's frame rate. The modes continue after the capture's last timestep.
    """
    pose, _, fps = pose_of(run, request, device)
    jobs = [(i / request.slow, camera, out / f"{camera.name}.png") for i, camera in enumerate(cameras)]
    videos = {"orbit.mp4": [path for *_, path in jobs]} if len(jobs) > 1 else {}
    return _render(run, cameras, request, out, "orbit", jobs, pose, videos, fps)


def render_path(
    run: Run,
    cameras: Sequence[Camera],
    request: RenderRequest,
    out: Path,
    video: bool = True,
    device: str = "cpu",
) -> Path:
    """Write OUT/r_000.png …, timestep t from the t-th of `cameras`, and OUT/path.mp4."""
    pose, _, fps = pose_of(run, request, device)
    jobs = [(float(t), camera, out / f"{camera.name}.png") for t, camera in enumerate(cameras)]
    videos = {"path.mp4": [path for *_, path in jobs]} if video else {}
    return _render(run, cameras, request, out, "path", jobs, pose, videos, fps)


def _render(
    run: Run,
    cameras: Sequence[Camera],
    request: RenderRequest,
    out: Path,
    kind: str,
    jobs: Sequence[Job],
    pose: Pose,
    videos: Mapping[str, Sequence[Path]],
    rate: float,
) -> Path:
    """Render missing pictures and make the videos {name: pictures} of `rate` pictures a second; returns OUT."""
    if videos:
        check_rate(rate)
    folder = work_folder(out)
    with folder.locked("renders into it"):
        folder.claim(record(run, request, cameras, kind))
        what = "rendering" if kind == "sequence" else kind
        at, label = close_up(run, pose), f"{what}, α = {request.label}"
        if request.kept is None or not videos:
            render_missing(jobs, at, request, label)
        for name, pictures in videos.items():
            if request.kept is None:
                _video_once(out / name, pictures, rate)
            elif not (out / name).exists():
                own = [job for job in jobs if job[2] in {*pictures}]
                size = own[0][1].width, own[0][1].height
                video_of(out / name, _rendered(own, at, request), size, len(own), rate, label)
    return out


def _rendered(
    jobs: Sequence[Job], pose: Callable[[float, Camera], Gaussians], request: RenderRequest
) -> Iterator[np.ndarray]:
    """Yield pictures as bytes; the first `request.kept` are written uncompressed, since they go soon."""
    for k, (time, camera, path) in enumerate(jobs):
        view = pose(time, camera), *camera.view
        image = to_bytes(render_image(*view, request.background, request.low_pass_px2))
        if k < (request.kept or 0):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, partial(Path.write_bytes, data=png.encode(image, 0, filtered=False)))
        yield image


def pose_of(run: Run, request: RenderRequest, device: str = "cpu") -> tuple[Pose, int, float]:
    """Return the magnified Gaussians (on `device`) as a function of the timestep, the timesteps, and fps in Hz."""
    poses = poses_of(run, request.checked().magnified, device)
    return poses.at, poses.n_timesteps, poses.fps


def render_missing(
    jobs: Sequence[Job],
    pose: Callable[[float, Camera], Gaussians],
    request: RenderRequest,
    label: str,
) -> int:
    """Render the jobs without a complete picture; returns their number."""
    todo = [job for job in jobs if not png.complete(job[2], job[1].width, job[1].height)]
    done = len(jobs) - len(todo)
    with progress(label, len(jobs), unit="pictures", start=done) as update:
        update(done)
        for time, camera, path in todo:
            seen = pose(time, camera)
            image = render_image(seen, *camera.view, request.background, request.low_pass_px2)
            write_png(path, image)
            done += 1
            update(done)
    return len(todo)


def close_up(run: Run, pose: Pose) -> Callable[[float, Camera], Gaussians]:
    """Return a function of time and camera: the Gaussians, for close cameras as wide as training drew them.

    The 0.3 px² by which training widened each Gaussian are fewer scene units there, and leave needles and holes
    (`show/export/lowpass.py`). The distance in training is unknown for a run without its dataset and a splat file.
    """
    known: list[tuple[np.ndarray, np.ndarray | None]] = []  # means at rest and their widening in training
    last: list[tuple[float, Gaussians]] = []

    def at(time: float, camera: Camera) -> Gaussians:
        if not last or last[0][0] != time:
            last[:] = [(time, pose(time))]
        gaussians = last[0][1]
        if not known:  # at the first picture: a complete folder needs none
            known.append((run.load_space().means.numpy().astype(np.float64), smoothing_of(run, warn=False)))
        means, variance = known[0]
        if variance is None:
            return gaussians
        extra = lacking(means, variance, camera.view)
        if extra is None:
            return gaussians
        added = torch.as_tensor(extra).to(gaussians.scales.device)
        wide = gaussians.scales.double().square() + added[:, None]
        return replace(gaussians, scales=wide.sqrt().to(gaussians.scales.dtype))

    return at


def _video_once(path: Path, pictures: Sequence[Path], fps: float) -> None:
    newest = max(picture.stat().st_mtime for picture in pictures)
    if not path.exists() or path.stat().st_mtime < newest:
        video_of_files(path, pictures, fps)


def work_folder(out: Path) -> WorkFolder:
    """Return OUT as the folder of a request, which OUT/render.json records."""
    others = {"cameras": "from other cameras", "model": "of another model"}
    return WorkFolder(out, RECORD, foreign_files="**/*.png", others=others)


def record(run: Run, request: RenderRequest, cameras: Sequence[Camera], kind: str) -> dict[str, Any]:
    """Return everything that determines the pictures, in JSON's types."""
    poses = json.dumps(transforms_json(tuple(cameras)), sort_keys=True)
    chosen = request.magnified
    method, temporal = method_of(run, chosen), chosen.filter
    one, several = chosen.bands[:1], len(chosen.bands) > 1
    return {
        "format": FORMAT,
        "version": 1,
        "kind": kind,
        "alpha": 0.0 if several else chosen.alpha,
        "band_hz": list(one[0].band) if one and not several else None,
        "bands": [[b.low, b.high, b.alpha] for b in chosen.bands] if several else None,
        "method": None if method == method_of(run, AS_CAPTURED) else method,  # null: the run's
        "filter": None if temporal is None else [temporal.kind, temporal.taps],
        "background": list(request.background),
        "slow": request.slow if kind == "orbit" else 1.0,
        "model": model_hash(run.path),
        **chosen.of_phase,
        "cameras": hashlib.sha256(poses.encode()).hexdigest(),
    }
