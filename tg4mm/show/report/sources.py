"""What a report is made of: the model, its scores, and what one camera sees as videos."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.capture.dataset_tree import magnified_alphas
from tg4mm.core.choices import Clock
from tg4mm.core.errors import CaptureError
from tg4mm.core.magnification import Magnification
from tg4mm.core.pictures.decode import read_png, to_bytes
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import PosedFrames, frames_of
from tg4mm.run import Run
from tg4mm.run.log import read_figures
from tg4mm.show.maps import blending_weights, image_motion, strongest
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_image
from tg4mm.show.render.sequence import RenderRequest, pose_of
from tg4mm.show.result.advice import suggested_alpha
from tg4mm.show.result.reading import Reading

METRICS = "metrics.json"
Evaluate = Callable[[Run], dict[str, Any]]  # scores against the ground truth, as metrics.json holds them


@dataclass(frozen=True)
class Model:
    """The trained model and how much each Gaussian counts."""

    gaussians: Gaussians
    motion: ModalMotion | None  # None: one timestep, or no mode
    weights: np.ndarray  # [N] blending weight summed over the training views
    main: int  # index of the in-band frequency with most motion
    uncertainty: np.ndarray | None = None  # [N] standard deviation of the displacement, rms, scene units


def load_model(reading: Reading, train: Capture, magnified: Magnification) -> Model:
    """The run's Gaussians and motion with blending weights. Raises RunError."""
    gaussians, motion = reading.gaussians, reading.motion
    if motion is not None and not len(motion.freqs_hz):
        motion = None
    weights = blending_weights(gaussians, train)
    main = strongest(motion, weights, magnified) if motion is not None else -1
    return Model(gaussians, motion, weights, main, reading.uncertainty.get("displacement"))


def choose_alpha(reading: Reading, noise_px: float | None, magnified: Magnification) -> tuple[float, str]:
    """What shows the motion in the bands well, and a sentence on how it was chosen; (0, "") without motion.

    Where there is ground truth, the largest α of it that is no larger than that. noise_px: the noise's amplitude in the
    pictures, also where no mode stands out of it; None: not known.
    """
    if reading.motion is None or not len(reading.motion.freqs_hz):
        return 0.0, ""
    gains = (magnified.inside(reading.motion.freqs_hz) & reading.motion.is_magnified()).astype(float)
    reach = reading.reach(gains)
    assert reach is not None  # there is a motion
    alpha = suggested_alpha(replace(reach, noise_px=noise_px), reading.capture)
    why = (
        "α was chosen so that the largest motion spans at most 4 % of the picture's shorter side, as long as its noise "
        "stays below a pixel and parts turn by less than half a radian"
    )
    known = [a for a in magnified_alphas(reading.run.dataset) if a <= alpha]
    if known:
        return float(max(known)), f"{why}; of the magnifications with ground truth the nearest below that."
    return alpha, f"{why}."


def metrics_of(run: Run, evaluate: Evaluate | None) -> dict[str, Any]:
    """RUN/metrics.json where it is newer than the model; else the run is scored now, if its dataset has ground truth.

    {} without ground truth, or without a newer file and `evaluate`. Raises RunError for a file that
    is damaged or of another kind.
    """
    dataset, path = run.dataset, run.path / METRICS
    if not magnified_alphas(dataset) and not (dataset / "truth" / "motion.npz").exists():
        return {}
    if path.exists() and path.stat().st_mtime >= _made(run):
        return read_figures(path)
    return evaluate(run) if evaluate is not None else {}


def _made(run: Run) -> float:
    files = [run.part_file(name) for name in ("space", "motion")]
    return max(file.stat().st_mtime for file in files if file.exists())


def contact_images(train: Capture, most: int = 30) -> list[np.ndarray]:
    """Pictures of the training cameras at their first timestep, evenly picked, at most `most`: uint8."""
    first = [int(np.flatnonzero(train.camera_ids == i)[0]) for i in dict.fromkeys(train.camera_ids.tolist())]
    picked = [
        first[i] for i in np.unique(np.linspace(0, len(first) - 1, min(most, len(first))).round().astype(int))
    ]
    images = load_images(train.selected(np.array(picked)))
    return [to_bytes(images.rgb(i)) for i in range(len(picked))]


MOST_FRAMES = 180  # of a video: what a page can hold
_MANY = 40  # poses of a moving camera that are looked at for where most is seen
_BYTES = 1 << 29  # of uncompressed pictures of one video

Pose = Callable[[float], Gaussians]


@dataclass(frozen=True)
class View:
    """One camera's videos, uint8 [T, H, W, 3]; None for what the dataset lacks.

    For a moving camera each picture has its own pose.
    """

    camera: Camera  # of a moving camera: where most motion is seen
    split: str  # the split that the camera is of
    magnified: Magnification
    ours: np.ndarray
    input: np.ndarray | None
    truth: np.ndarray | None
    why_no_truth: str = ""
    clock: Clock = Clock.synchronous  # `Observations.clock`
    n_frames: int = 0  # that the camera took; more than the video holds where the record is long
    # of a moving camera: α = 0 and α, rendered from `camera`
    fixed: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def alpha(self) -> float:
        return self.magnified.alpha

    @property
    def widest_time(self) -> int:
        """The timestep whose magnified picture differs most from the first: shown where nothing can play."""
        shown = self.ours if self.fixed is None else self.fixed[1]
        return int(np.argmax([np.abs(one.astype(np.int16) - shown[0]).mean() for one in shown]))


@dataclass(frozen=True)
class Shown:
    """A magnified video that there is."""

    magnified: Magnification
    folder: Path  # its pictures, as `render_sequence` or `render_orbit` leaves them

    def camera_of(self, shots: Sequence[PosedFrames]) -> int | None:
        """Which of the cameras it was rendered from; None where it is of none, or its pictures are gone."""
        named = [k for k, shot in enumerate(shots) if (self.folder / "000" / f"{shot.name}.png").is_file()]
        return named[0] if named else None

    def pictures(self, name: str, count: int) -> np.ndarray | None:
        """[count, H, W, 3] uint8 of the first timesteps; None where some are missing."""
        files = [self.folder / f"{t:03d}" / f"{name}.png" for t in range(count)]
        return np.stack([read_png(f) for f in files]) if all(f.is_file() for f in files) else None


def gather_view(
    run: Run, train: Capture, model: Model, magnified: Magnification, shown: Shown | None = None
) -> View:
    """Render the camera that sees most motion, and read its pictures and ground truth.

    shown: a video of the same magnification; its camera and its pictures are taken, not rendered again.
    """
    split, clock, shots = _shots(run.dataset, train)
    there = None if shown is None or clock != Clock.synchronous else shown.camera_of(shots)
    best = _most_telling(train, model, shots) if there is None else there
    alpha = magnified.alpha
    pose, n_timesteps, fps = pose_of(run, RenderRequest(magnified))
    size = train.width, train.height
    camera = Camera.of(shots[best], size)
    if n_timesteps == 1:
        ours = _rendered(pose, [(0.0, camera)], "report")
        return View(
            camera, split.split, magnified, ours, _pictures(split, shots[best].rows[:1]), None, n_frames=1
        )
    own = list(shots) if clock == Clock.moving else [shots[best]] * len(shots[best].rows)
    rows = [f.rows[0] for f in own] if clock == Clock.moving else shots[best].rows.tolist()
    kept = _kept(len(rows), train)
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
    return View(camera, split.split, magnified, ours, recorded, truth, why, clock, len(rows), fixed)


def _shots(dataset: Path, train: Capture) -> tuple[Capture, Clock, Sequence[PosedFrames]]:
    """The test cameras that stay put over time, else what shows motion of the training pictures, with its clock."""
    if train.n_timesteps == 1:
        rows = np.arange(min(1, len(train)))
        return train, Clock.synchronous, [_posed(train, rows)]
    try:
        test = load_capture(dataset, split="test")
        clock, frames = frames_of(test)
        if clock != Clock.moving:
            return test, clock, frames
    except CaptureError:
        pass
    return train, *frames_of(train)


def _posed(capture: Capture, rows: np.ndarray) -> PosedFrames:
    i = int(rows[0])
    return PosedFrames(capture.paths[i].stem, capture.viewmats[i], capture.Ks[i], rows, capture.times_s[rows])


def _most_telling(train: Capture, model: Model, shots: Sequence[PosedFrames]) -> int:
    if model.motion is None:
        return 0
    phasors = model.motion.displacement[model.main]
    some = np.unique(np.linspace(0, len(shots) - 1, min(len(shots), _MANY)).round().astype(int))
    seen = [
        image_motion(
            model.gaussians, phasors, model.weights, Camera.of(shots[i], (train.width, train.height))
        )
        for i in some
    ]
    return int(some[int(np.argmax(seen))])


def _kept(n: int, capture: Capture) -> int:
    return max(1, min(n, MOST_FRAMES, _BYTES // (capture.width * capture.height * 3)))


def _rendered(pose: Pose, jobs: Sequence[tuple[float, Camera]], label: str) -> np.ndarray:
    frames = []
    with progress(label, len(jobs), unit="pictures") as update:
        for i, (t, camera) in enumerate(jobs):
            size = (camera.width, camera.height)
            frames.append(to_bytes(render_image(pose(t), camera.viewmat, camera.K, *size)))
            update(i + 1)
    return np.stack(frames)


def _pictures(capture: Capture, rows: np.ndarray) -> np.ndarray:
    images = load_images(capture.selected(np.asarray(rows)))
    return np.stack([to_bytes(images.rgb(i)) for i in range(len(rows))])


def _truth(dataset: Path, split: Capture, rows: list[int], alpha: float) -> tuple[np.ndarray | None, str]:
    """The ground truth of the pictures `rows` of one camera, or why there is none; "" where none can be expected."""
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
