"""A run rendered over time from given cameras; complete pictures stay, foreign ones are refused."""

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tg4mm.core.errors import RunError
from tg4mm.core.magnification import AS_CAPTURED, LARGEST_ALPHA, Magnification
from tg4mm.core.pictures import png
from tg4mm.core.pictures.decode import write_png
from tg4mm.core.progress import progress
from tg4mm.core.work_folder import WorkFolder
from tg4mm.fit.gaussians import Gaussians
from tg4mm.run import Run
from tg4mm.run.preset import method_of, poses_of
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.export.lowpass import lacking, smoothing_of
from tg4mm.show.render.cameras import Camera, transforms_json
from tg4mm.show.render.image import WHITE, render_image
from tg4mm.show.render.video import check_rate, video_of_files

RECORD = "render.json"
FORMAT = "tg4mm-render"
Pose = Callable[[float], Gaussians]  # timestep, may be fractional, to the Gaussians at that time


@dataclass(frozen=True)
class RenderRequest:
    """A render request, recorded in DIR/render.json so that DIR never mixes pictures of two requests."""

    magnified: Magnification = AS_CAPTURED
    background: tuple[float, float, float] = WHITE
    slow: float = 1.0  # 2 = videos at half speed
    low_pass_px2: float = 0.3  # drawn wider by, square pixels; less where a file's scales hold some of it

    def checked(self) -> "RenderRequest":
        """Itself. Raises RunError for an alpha or a speed that is out of range."""
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

    Pictures that are complete are kept, whatever device they come from. Raises RunError where OUT holds another
    request, where the run has no motion but alpha is not 0, or where a timestep does not exist.
    """
    pose, n_timesteps, fps = pose_of(run, request, device)
    wanted = list(range(n_timesteps)) if timesteps is None else [int(t) for t in timesteps]
    for t in wanted:
        if not 0 <= t < n_timesteps:
            raise RunError(f"timestep {t} is outside 0 … {n_timesteps - 1}")
    if video and len(wanted) > 1:
        check_rate(fps / request.slow)
    folder = work_folder(out)
    with folder.held("renders into it"):
        folder.claim(record(run, request, cameras, "sequence"))
        files = {
            (t, camera.name): out / f"{t:03d}" / f"{camera.name}.png" for t in wanted for camera in cameras
        }
        jobs = [(float(t), camera, files[t, camera.name]) for t in wanted for camera in cameras]
        render_missing(jobs, close_up(run, pose), request, f"rendering, α = {request.label}")
        if video and len(wanted) > 1:
            speed = "" if request.slow == 1 else f"_slow{request.slow:g}"
            for camera in cameras:
                pictures = [files[t, camera.name] for t in wanted]
                _video_once(out / f"{camera.name}{speed}.mp4", pictures, fps / request.slow)
    return out


def render_orbit(
    run: Run, cameras: Sequence[Camera], request: RenderRequest, out: Path, device: str = "cpu"
) -> Path:
    """Write OUT/r_000.png …, one per camera, while time runs on, and OUT/orbit.mp4.

    The motion is a function of time, so slow motion has its own frames in between: frame i shows the
    time i / slow and plays at the capture's frame rate. Past the capture's last timestep the modes go on.
    """
    pose, _, fps = pose_of(run, request, device)
    if len(cameras) > 1:
        check_rate(fps)
    folder = work_folder(out)
    with folder.held("renders into it"):
        folder.claim(record(run, request, cameras, "orbit"))
        jobs = [(i / request.slow, camera, out / f"{camera.name}.png") for i, camera in enumerate(cameras)]
        render_missing(jobs, close_up(run, pose), request, f"orbit, α = {request.label}")
        pictures = [path for _, _, path in jobs]
        if len(pictures) > 1:
            _video_once(out / "orbit.mp4", pictures, fps)
    return out


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
    if video:
        check_rate(fps)
    folder = work_folder(out)
    with folder.held("renders into it"):
        folder.claim(record(run, request, cameras, "path"))
        jobs = [(float(t), camera, out / f"{camera.name}.png") for t, camera in enumerate(cameras)]
        render_missing(jobs, close_up(run, pose), request, f"path, α = {request.label}")
        if video:
            _video_once(out / "path.mp4", [path for _, _, path in jobs], fps)
    return out


def pose_of(run: Run, request: RenderRequest, device: str = "cpu") -> tuple[Pose, int, float]:
    """The magnified Gaussians (on `device`) as a function of the timestep, the number of timesteps, and fps in Hz."""
    poses = poses_of(run, request.checked().magnified, device)
    return poses.at, poses.n_timesteps, poses.fps


def render_missing(
    jobs: Sequence[tuple[float, Camera, Path]],
    pose: Callable[[float, Camera], Gaussians],
    request: RenderRequest,
    label: str,
) -> int:
    """Render the (time, camera, file) jobs whose file is not complete; returns how many were rendered."""
    todo = [job for job in jobs if not png.complete(job[2], job[1].width, job[1].height)]
    done = len(jobs) - len(todo)
    with progress(label, len(jobs), unit="pictures", start=done) as update:
        update(done)
        for time, camera, path in todo:
            size = (camera.width, camera.height)
            picture = render_image(
                pose(time, camera),
                camera.viewmat,
                camera.K,
                *size,
                background=request.background,
                low_pass_px2=request.low_pass_px2,
            )
            write_png(path, picture)
            done += 1
            update(done)
    return len(todo)


def close_up(run: Run, pose: Pose) -> Callable[[float, Camera], Gaussians]:
    """The Gaussians at a time for a camera: from closer than training was, as wide as training drew them.

    The 0.3 px² that training drew each Gaussian wider by are fewer scene units there, and leave needles and holes
    (`show/export/lowpass.py`). A run whose dataset is gone, and a splat file, do not say how near training was.
    """
    known: list[
        tuple[np.ndarray, np.ndarray | None]
    ] = []  # means at rest and what training drew them wider by
    last: list[tuple[float, Gaussians]] = []

    def at(time: float, camera: Camera) -> Gaussians:
        if not last or last[0][0] != time:
            last[:] = [(time, pose(time))]
        gaussians = last[0][1]
        if not known:  # of the first picture on: a folder that is complete needs none
            known.append((run.load_space().means.numpy().astype(np.float64), smoothing_of(run, warn=False)))
        means, variance = known[0]
        if variance is None:
            return gaussians
        extra = lacking(means, variance, (camera.viewmat, camera.K, camera.width, camera.height))
        if extra is None:
            return gaussians
        wide = (
            gaussians.scales.double().square() + torch.as_tensor(extra).to(gaussians.scales.device)[:, None]
        )
        return replace(gaussians, scales=wide.sqrt().to(gaussians.scales.dtype))

    return at


def _video_once(path: Path, pictures: Sequence[Path], fps: float) -> None:
    newest = max(picture.stat().st_mtime for picture in pictures)
    if not path.exists() or path.stat().st_mtime < newest:
        video_of_files(path, pictures, fps)


def work_folder(out: Path) -> WorkFolder:
    """OUT as a folder that belongs to a request: OUT/render.json."""
    others = {"cameras": "from other cameras", "model": "of another model"}
    return WorkFolder(out, RECORD, strangers="**/*.png", others=others)


def record(run: Run, request: RenderRequest, cameras: Sequence[Camera], kind: str) -> dict[str, Any]:
    """All that the pictures depend on, in JSON's types."""
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
        "method": None if method == method_of(run, AS_CAPTURED) else method,  # null: the run's own
        "filter": None if temporal is None else [temporal.kind, temporal.taps],
        "background": list(request.background),
        "slow": request.slow if kind == "orbit" else 1.0,
        "model": model_hash(run.path),
        **chosen.of_phase,
        "cameras": hashlib.sha256(poses.encode()).hexdigest(),
    }
