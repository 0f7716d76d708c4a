"""What a report is made of: one view's videos (input, ours, truth), the model, why something is missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.errors import CaptureError
from tg4mm.evaluate.weights import blending_weights
from tg4mm.gaussians import Gaussians
from tg4mm.motion.modes import ModalMotion
from tg4mm.progress import progress
from tg4mm.render.cameras import Camera, capture_cameras
from tg4mm.render.frames import to_bytes
from tg4mm.render.image import render_image
from tg4mm.render.sequence import RenderRequest, pose_of
from tg4mm.report.maps import image_motion, strongest
from tg4mm.runs import Run

DEFAULT_ALPHA = 20.0


@dataclass(frozen=True)
class View:
    """One camera's videos, uint8 [T, H, W, 3]; what a dataset lacks is None."""

    camera: Camera
    split: str  # the split that the camera is of
    alpha: float
    ours: np.ndarray
    input: np.ndarray | None
    truth: np.ndarray | None
    why_no_input: str = ""
    why_no_truth: str = ""

    @property
    def widest_time(self) -> int:
        """The timestep whose magnified picture differs most from the first: shown where nothing can play."""
        change = np.abs(self.ours.astype(np.int16) - self.ours[:1]).mean(axis=(1, 2, 3))
        return int(np.argmax(change))


@dataclass(frozen=True)
class Model:
    """The trained model and how much each Gaussian counts."""

    gaussians: Gaussians
    motion: ModalMotion | None
    weights: np.ndarray  # [N] blending weight summed over the training views
    main: int  # index of the in-band frequency with most motion
    uncertainty: np.ndarray | None = None  # [N] standard deviation of the displacement, rms, scene units


def load_model(run: Run, train: Capture, band: tuple[float, float] | None) -> Model:
    """The run's Gaussians and motion with blending weights. Raises RunError."""
    gaussians = run.load_space()
    motion = run.load_motion()
    weights = blending_weights(gaussians, train)
    main = strongest(motion, weights, band) if motion is not None else -1
    return Model(gaussians, motion, weights, main, run.load_uncertainty())


def test_split(dataset: Path) -> Capture | None:
    """The test cameras over time, None where the dataset has none."""
    try:
        return load_capture(dataset, split="test")
    except CaptureError:
        return None


def alphas_with_truth(dataset: Path) -> list[int]:
    """The magnifications that the dataset has ground truth for, from its folder names."""
    names = [path.name[1:] for path in (dataset / "magnified").glob("x*") if path.is_dir()]
    return sorted(int(name) for name in names if name.isdigit())


def choose_alpha(dataset: Path, wanted: float | None) -> float:
    """`wanted` if given, else the magnification nearest to 20 that has ground truth, else 20."""
    if wanted is not None:
        return float(wanted)
    known = alphas_with_truth(dataset)
    return float(min(known, key=lambda a: abs(a - DEFAULT_ALPHA))) if known else DEFAULT_ALPHA


def gather_view(
    run: Run, train: Capture, model: Model, alpha: float, band: tuple[float, float] | None
) -> View:
    """Render the camera that sees most motion, and read its pictures and ground truth."""
    test = test_split(run.dataset)
    capture = test if test is not None else train
    camera, camera_id = _most_telling(capture, model)
    request = RenderRequest(alpha=alpha, band=band)
    pose, n_timesteps, _ = pose_of(run, request)
    ours = _render(pose, n_timesteps, camera, f"report, α = {alpha:g}")
    recorded, why_no_input = _video_of(capture, camera_id)
    if len(ours) == 1 < capture.n_timesteps:  # a run without motion: all it can show is the first
        recorded = recorded[:1] if recorded is not None else None
    truth, why_no_truth = _truth(run.dataset, test, camera_id, alpha)
    return View(camera, capture.split, alpha, ours, recorded, truth, why_no_input, why_no_truth)


def _most_telling(capture: Capture, model: Model) -> tuple[Camera, int]:
    cameras = capture_cameras(capture)
    ids = list(dict.fromkeys(capture.camera_ids.tolist()))
    if model.motion is None:
        return cameras[0], ids[0]
    phasors = model.motion.displacement[model.main]
    seen = [image_motion(model.gaussians, phasors, model.weights, camera) for camera in cameras]
    best = int(np.argmax(seen))
    return cameras[best], ids[best]


def _render(pose: Callable[[float], Gaussians], n: int, camera: Camera, label: str) -> np.ndarray:
    frames = []
    with progress(label, n, unit="frames") as update:
        for t in range(n):
            size = (camera.width, camera.height)
            frames.append(to_bytes(render_image(pose(t), camera.viewmat, camera.K, *size)))
            update(t + 1)
    return np.stack(frames)


def _video_of(capture: Capture, camera_id: int) -> tuple[np.ndarray | None, str]:
    """The pictures of one camera over all timesteps, or why there is no such video."""
    rows = np.flatnonzero(capture.camera_ids == camera_id)
    rows = rows[np.argsort(capture.timesteps[rows], kind="stable")]
    if len(rows) != capture.n_timesteps:
        return (
            None,
            f"No camera stands still: this one took {len(rows)} of the {capture.n_timesteps} timesteps.",
        )
    images = load_images(capture.selected(rows))
    return np.stack([to_bytes(images.rgb(i)) for i in range(len(rows))]), ""


def _truth(
    dataset: Path, test: Capture | None, camera_id: int, alpha: float
) -> tuple[np.ndarray | None, str]:
    if test is None:
        return None, "The dataset has no test split, so there is no ground truth to compare with."
    if alpha != int(alpha) or int(alpha) not in alphas_with_truth(dataset):
        return None, f"The dataset has no ground truth at α = {alpha:g}."
    magnified = load_capture(dataset, split="test", magnification=int(alpha))
    # The same camera: magnified/ has the test split's file names and poses.
    row = int(np.flatnonzero(test.camera_ids == camera_id)[0])
    distance = np.abs(magnified.viewmats - test.viewmats[row]).max(axis=(1, 2))
    if distance.min() > 1e-6:
        return None, f"The ground truth at α = {alpha:g} was not rendered from this camera."
    return _video_of(magnified, int(magnified.camera_ids[int(np.argmin(distance))]))


def contact_images(train: Capture, most: int = 30) -> list[np.ndarray]:
    """Pictures of the training cameras at their first timestep, evenly picked, at most `most`: uint8."""
    first = [int(np.flatnonzero(train.camera_ids == i)[0]) for i in dict.fromkeys(train.camera_ids.tolist())]
    picked = [
        first[i] for i in np.unique(np.linspace(0, len(first) - 1, min(most, len(first))).round().astype(int))
    ]
    images = load_images(train.selected(np.array(picked)))
    return [to_bytes(images.rgb(i)) for i in range(len(picked))]
