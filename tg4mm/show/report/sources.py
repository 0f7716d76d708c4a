"""The input of a report: the model, its scores, and one camera's videos."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.dataset_tree import magnified_alphas
from tg4mm.capture.pictures import some_pictures
from tg4mm.core.choices import Clock
from tg4mm.core.errors import CaptureError
from tg4mm.core.magnification import Magnification
from tg4mm.core.pictures.decode import bytes_over_white, read_png, to_bytes
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import PosedFrames, frames_of
from tg4mm.run import Run
from tg4mm.run.log import read_figures
from tg4mm.show.maps import blending_weights, evenly, image_motion, strongest
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render
from tg4mm.show.render.sequence import RenderRequest, pose_of
from tg4mm.show.result.advice import suggested_alpha
from tg4mm.show.result.reading import ResultSources

METRICS = "metrics.json"
Evaluate = Callable[[Run], dict[str, Any]]  # scores against the ground truth, as metrics.json holds them
MOST_FRAMES = 180  # of a video: what a page can hold
_MANY = 40  # poses of a moving camera that are compared
_BYTES = 1 << 29  # of uncompressed pictures of one video


@dataclass(frozen=True)
class Model:
    """The trained model and the visibility of its Gaussians."""

    gaussians: Gaussians
    motion: ModalMotion | None  # None: one timestep, or no mode
    weights: np.ndarray  # [N] blending weight summed over the training views
    main: int  # index of the in-band frequency with most motion; -1 without motion
    uncertainty: np.ndarray | None = None  # [N] standard deviation of the displacement, rms, scene units


def load_model(reading: ResultSources, train: Capture, magnified: Magnification) -> Model:
    """Return the run's Gaussians and motion with blending weights. Raises RunError."""
    gaussians, motion = reading.gaussians, reading.motion
    if motion is not None and not len(motion.freqs_hz):
        motion = None
    weights = blending_weights(gaussians, train)
    main = strongest(motion, weights, magnified) if motion is not None else -1
    return Model(gaussians, motion, weights, main, reading.uncertainty.get("displacement"))


def choose_alpha(
    reading: ResultSources, noise_px: float | None, magnified: Magnification
) -> tuple[float, str]:
    """Choose an α that shows the motion in the bands well; return it with a reason, or (0, "") without motion.

    With ground truth, the largest α of it up to that one. noise_px: the noise's amplitude in the pictures; None:
    unknown.
    """
    if reading.motion is None or not len(reading.motion.freqs_hz):
        return 0.0, ""
    gains = (magnified.inside(reading.motion.freqs_hz) & reading.motion.is_magnified()).astype(float)
    limits = reading.limits(gains)
    assert limits is not None  # there is a motion
    alpha = suggested_alpha(replace(limits, noise_px=noise_px), reading.capture)
    why = (
        "α was chosen so that the largest motion spans at most 4 % of the picture's shorter side, as long as its noise "
        "stays below a pixel and parts turn by less than half a radian"
    )
    known = [a for a in magnified_alphas(reading.run.dataset) if a <= alpha]
    if known:
        return float(max(known)), f"{why}; it is the largest α with ground truth up to that."
    return alpha, f"{why}."


def metrics_of(run: Run, evaluate: Evaluate | None) -> dict[str, Any]:
    """Read RUN/metrics.json if it is newer than the model, else score the run if its dataset has ground truth.

    {} without ground truth, or without a newer file and `evaluate`. Raises RunError for a damaged or foreign file.
    """
    dataset, path = run.dataset, run.path / METRICS
    if not magnified_alphas(dataset) and not (dataset / "truth" / "motion.npz").exists():
        return {}
    files = [run.part_file(name) for name in ("space", "motion")]
    made = max(file.stat().st_mtime for file in files if file.exists())
    if path.exists() and path.stat().st_mtime >= made:
        return read_figures(path)
    return evaluate(run) if evaluate is not None else {}


def contact_images(train: Capture, most: int = 30) -> list[np.ndarray]:
    """Return uint8 pictures of at most `most` training cameras, evenly picked, at their first timestep."""
    first = np.sort(np.unique(train.camera_ids, return_index=True)[1])
    return list(_pictures(train, first[evenly(len(first), most)]))


Pose = Callable[[float], Gaussians]


@dataclass(frozen=True)
class CameraVideos:
    """One camera's videos, uint8 [T, H, W, 3]; None for what the dataset lacks.

    For a moving camera each picture has its own pose.
    """

    camera: Camera  # for a moving camera: the pose that sees most motion
    split: str  # the camera's split
    magnified: Magnification
    ours: np.ndarray
    input: np.ndarray | None
    truth: np.ndarray | None
    why_no_truth: str = ""
    clock: Clock = Clock.synchronous  # `Observations.clock`
    n_frames: int = 0  # of the camera; the video of a long record holds fewer
    # for a moving camera: α = 0 and α, rendered from `camera`
    fixed: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def alpha(self) -> float:
        return self.magnified.alpha

    @property
    def widest_time(self) -> int:
        """The timestep whose magnified picture differs most from the first: shown where videos cannot play."""
        shown = self.ours if self.fixed is None else self.fixed[1]
        return int(np.argmax([np.abs(one.astype(np.int16) - shown[0]).mean() for one in shown]))


@dataclass(frozen=True)
class Shown:
    """A finished magnified video."""

    magnified: Magnification
    folder: Path  # its pictures, as written by `render_sequence` or `render_orbit`

    def camera_of(self, shots: Sequence[PosedFrames]) -> int | None:
        """Return the index of its camera; None if it is not among `shots` or its pictures are gone."""
        named = [k for k, shot in enumerate(shots) if (self.folder / "000" / f"{shot.name}.png").is_file()]
        return named[0] if named else None

    def pictures(self, name: str, count: int) -> np.ndarray | None:
        """Return the pictures [count, H, W, 3] uint8 of the first timesteps; None if some are missing."""
        files = [self.folder / f"{t:03d}" / f"{name}.png" for t in range(count)]
        return np.stack([read_png(f) for f in files]) if all(f.is_file() for f in files) else None


def gather_view(
    run: Run, train: Capture, model: Model, magnified: Magnification, shown: Shown | None = None
) -> CameraVideos:
    """Render the camera that sees most motion, and read its pictures and ground truth.

    shown: a video of the same magnification whose camera and pictures are used instead of rendering.
    """
    split, clock, shots = _shots(run.dataset, train)
    there = None if shown is None or clock != Clock.synchronous else shown.camera_of(shots)
    best = _most_telling(train, model, shots) if there is None else there
    alpha = magnified.alpha
    pose, n_timesteps, fps = pose_of(run, RenderRequest(magnified))
    size = train.width, train.height
    camera = Camera.of(shots[best], size)
    if n_timesteps == 1:
        ours, recorded = _rendered(pose, [(0.0, camera)], "report"), _pictures(split, shots[best].rows[:1])
        return CameraVideos(camera, split.split, magnified, ours, recorded, None, n_frames=1)
    own = list(shots) if clock == Clock.moving else [shots[best]] * len(shots[best].rows)
    rows = [f.rows[0] for f in own] if clock == Clock.moving else shots[best].rows.tolist()
    kept = shown_of(len(rows), train)
    jobs = [(float(split.times_s[rows[i]]) * fps, Camera.of(own[i], size)) for i in range(kept)]
    jobs = [(t - jobs[0][0] if clock == Clock.independent else t, c) for t, c in jobs]
    found = None if there is None or shown is None else shown.pictures(shots[best].name, kept)
    ours = _rendered(pose, jobs, f"magnified view, α = {alpha:g}") if found is None else found
    fixed = None
    if clock == Clock.moving:
        still, _, _ = pose_of(run, RenderRequest())
        posed = [(t, camera) for t, _ in jobs]
        fixed = _rendered(still, posed, "one pose, α = 0"), _rendered(pose, posed, f"one pose, α = {alpha:g}")
    recorded = _pictures(split, np.array(rows[:kept]))
    truth, why = _truth(run.dataset, split, rows[:kept], alpha)
    return CameraVideos(camera, split.split, magnified, ours, recorded, truth, why, clock, len(rows), fixed)


def _shots(dataset: Path, train: Capture) -> tuple[Capture, Clock, Sequence[PosedFrames]]:
    """Return the test cameras if they are fixed, else the training cameras that show motion, with their clock."""
    if train.n_timesteps == 1:
        still = PosedFrames(
            train.paths[0].stem, train.viewmats[0], train.Ks[0], np.arange(1), train.times_s[:1]
        )
        return train, Clock.synchronous, [still]
    try:
        test = load_capture(dataset, split="test")
        clock, frames = frames_of(test)
        if clock != Clock.moving:
            return test, clock, frames
    except CaptureError:
        pass
    return train, *frames_of(train)


def _most_telling(train: Capture, model: Model, shots: Sequence[PosedFrames]) -> int:
    if model.motion is None:
        return 0
    size, some = (train.width, train.height), evenly(len(shots), _MANY)
    cameras = [Camera.of(shots[i], size) for i in some]
    seen = [image_motion(model.gaussians, model.motion, model.weights, c)[model.main] for c in cameras]
    return int(some[int(np.argmax(seen))])


def shown_of(n: int, capture: Capture) -> int:
    """Return how many of n pictures a report's video has."""
    return max(1, min(n, MOST_FRAMES, _BYTES // (capture.width * capture.height * 3)))


def _rendered(pose: Pose, jobs: Sequence[tuple[float, Camera]], label: str) -> np.ndarray:
    frames = []
    with progress(label, len(jobs), unit="pictures") as update:
        for i, (t, camera) in enumerate(jobs):
            frames.append(to_bytes(render(pose(t), camera)))
            update(i + 1)
    return np.stack(frames)


def _pictures(capture: Capture, rows: np.ndarray) -> np.ndarray:
    images = some_pictures(capture, np.asarray(rows))
    return np.stack([bytes_over_white(images.stored(i)) for i in range(len(rows))])


def _truth(dataset: Path, split: Capture, rows: list[int], alpha: float) -> tuple[np.ndarray | None, str]:
    """Return the ground truth of the pictures `rows` of one camera, or a reason why not; "" if none is expected."""
    known = magnified_alphas(dataset)
    if not known or split.split != "test":
        return None, ""
    if alpha != int(alpha) or int(alpha) not in known:
        there = ", ".join(str(a) for a in known)
        return None, f"The dataset has no ground truth at α = {alpha:g}; there is some at {there}."
    magnified = load_capture(dataset, split="test", magnification=int(alpha))
    # The same camera: magnified/ has the test split's file names and poses.
    distance = np.abs(magnified.viewmats - split.viewmats[rows[0]]).max(axis=(1, 2))
    row_at = {int(magnified.timesteps[i]): int(i) for i in np.flatnonzero(distance <= 1e-6)}
    found = [row_at[t] for t in split.timesteps[rows].tolist() if t in row_at]
    if not found:
        return None, f"The ground truth at α = {alpha:g} was not rendered from this camera."
    if len(found) < len(rows):
        what = f"{len(found)} of {len(rows)} timesteps from this camera"
        return None, f"The ground truth at α = {alpha:g} holds {what}: they are scored, and do not play here."
    return _pictures(magnified, np.array(found)), ""
