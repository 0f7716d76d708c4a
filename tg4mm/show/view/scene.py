"""The contents of a run for display: Gaussians, motion, deviations, units, cameras, and the film's pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.look import LookSummary
from tg4mm.capture.pictures import FilePictures
from tg4mm.core.choices import Clock
from tg4mm.core.errors import CaptureError
from tg4mm.core.magnification import AS_CAPTURED, Magnification
from tg4mm.core.phasors import peak_displacement, scale_top
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.run.stages import look_of
from tg4mm.show.maps import blending_weights, evenly, leading_modes, middle_depth
from tg4mm.show.render.cameras import Camera, capture_cameras, look_at
from tg4mm.show.result import result_of
from tg4mm.show.result.model import unit_of

_SAME_PLACE = 1e-3  # of the distance to what is looked at
_LOOKED_FROM = 8  # cameras that give the Gaussians' weights


@dataclass(frozen=True)
class Standpoint:
    """A browser's camera; world axes, scene units."""

    position: np.ndarray  # [3]
    target: np.ndarray  # [3] a point on the axis, which the mouse turns around
    up: np.ndarray  # [3] unit vector
    fov: float  # radians, from top to bottom


def standpoint_of(camera: Camera, depth: float, aspect: float) -> Standpoint:
    """Return the browser camera with the field of view of `camera`, on a canvas of width / height `aspect`.

    `depth` (scene units) along its axis is the point to turn around.
    """
    half_height = camera.height / 2 / camera.K[1, 1]
    half_width = camera.width / 2 / camera.K[0, 0]
    fov = 2 * math.atan(max(half_height, half_width / aspect))
    return Standpoint(camera.position, camera.position + depth * camera.forward, -camera.viewmat[1, :3], fov)


def camera_of(
    position: np.ndarray, rotation: np.ndarray, fov: float, aspect: float, size: tuple[int, int]
) -> Camera:
    """Return the camera of a canvas for a picture of `size` (width, height), pixels.

    position [3] and rotation [3, 3] (camera to world, OpenCV axes); `fov` radians from top to bottom; `aspect`: the
    canvas' width / height, which the rounded size only approximates.
    """
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.T
    viewmat[:3, 3] = -rotation.T @ position
    width, height = size
    tangent = math.tan(fov / 2)
    focal = width / 2 / (tangent * aspect), height / 2 / tangent
    K = np.array([[focal[0], 0, width / 2], [0, focal[1], height / 2], [0, 0, 1.0]])
    return Camera("view", viewmat, K, width, height)


def overview(means: np.ndarray, size: int = 768) -> Camera:
    """Return a camera that sees the middle 90 % of points [N, 3] from the side, for a scene without a capture."""
    low, high = np.quantile(means, 0.05, axis=0), np.quantile(means, 0.95, axis=0)
    centre = (low + high) / 2
    radius = max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    focal = 1.2 * size
    position = centre + 3.0 * radius * np.array([0.0, -0.94, 0.34])
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    return Camera("overview", look_at(position, centre), K, size, size)


class Filmed:
    """Pictures of fixed cameras on a common clock; those of clips are not used."""

    def __init__(self, capture: Capture, depth: float) -> None:
        """`depth`: distance of the scene, scene units."""
        self._capture, self._pictures = capture, FilePictures(capture)
        ids, timed = capture.camera_ids, np.isfinite(capture.times_s)
        several = [np.flatnonzero((ids == k) & timed) for k in np.unique(ids)]
        self._rows: Sequence[np.ndarray] = [
            rows for rows in several if len(rows) > 1 and capture.clocks != Clock.independent
        ]
        self._near = _SAME_PLACE * depth

    def seen_by(self, camera: Camera, seconds: float) -> np.ndarray | None:
        """Return the picture [height, width, 3] uint8 nearest to that moment, white beyond its edges.

        None if no camera stood there. For a turned or zoomed camera it is warped: a rotation in place is a homography
        (Hartley & Zisserman, §8.4.2).
        """
        for rows in self._rows:
            viewmat, K = self._capture.viewmats[rows[0]], self._capture.Ks[rows[0]]
            position = -viewmat[:3, :3].T @ viewmat[:3, 3]
            if np.linalg.norm(position - camera.position) < self._near:
                row = int(rows[np.argmin(np.abs(self._capture.times_s[rows] - seconds))])
                turned = K @ viewmat[:3, :3] @ camera.viewmat[:3, :3].T @ np.linalg.inv(camera.K)
                return _warped(to_bytes(self._pictures.rgb(row)), turned, (camera.width, camera.height))
        return None


def _warped(picture: np.ndarray, homography: np.ndarray, size: tuple[int, int]) -> np.ndarray | None:
    """Warp a picture [H, W, 3] to [h, w, 3]; homography [3, 3]: from pixels (x, y, 1) of the result to the picture."""
    if homography[2, 2] <= 0:  # turned away
        return None
    factors = (homography / homography[2, 2]).ravel()[:8].tolist()
    seen = Image.fromarray(picture).transform(
        size, Image.Transform.PERSPECTIVE, factors, Image.Resampling.BILINEAR, fillcolor=(255, 255, 255)
    )
    return np.array(seen)


@dataclass(frozen=True)
class RunScene:
    """A run for display."""

    path: Path
    gaussians: Gaussians
    motion: ModalMotion | None
    weights: np.ndarray  # [N] blending weight of each Gaussian in the capture's pictures, any unit
    deviation: np.ndarray | None  # [N] standard deviation of the displacement, rms over time, scene units
    cameras: tuple[Camera, ...]  # of the capture, or an overview
    unit: str  # of displayed lengths
    per_unit: float  # displayed length per scene unit
    notes: tuple[str, ...] = ()  # lines on missing data
    look: LookSummary | None = None  # result of the look at a flat capture's regions
    filmed: Filmed | None = None  # the capture's pictures

    @property
    def duration(self) -> float:
        """Seconds of the capture; 0 where nothing moves."""
        if self.motion is None or not len(self.frequencies):
            return 0.0
        return self.motion.n_timesteps / self.motion.fps

    @property
    def frequencies(self) -> np.ndarray:
        """The magnified frequencies [K] in Hz, ascending."""
        if self.motion is None:
            return np.zeros(0)
        return np.sort(self.motion.freqs_hz[self.motion.is_magnified()])

    def strongest(self, magnified: Magnification = AS_CAPTURED) -> int | None:
        """Return the index of the in-band mode with most motion; None if no magnified mode is in the bands."""
        if self.motion is None or not len(self.motion.freqs_hz):
            return None
        leading = leading_modes(self.motion, self.weights, magnified, most=1)
        return next((k for k in leading if self.motion.is_magnified()[k]), None)

    def peaks(self) -> np.ndarray:
        """Return the displacement [K] of every magnified frequency that 0.5 % of the visible Gaussians exceed."""
        if self.motion is None:
            return np.zeros(0)
        rows = np.flatnonzero(self.motion.is_magnified())
        rows = rows[np.argsort(self.motion.freqs_hz[rows], kind="stable")]
        found = [scale_top(peak_displacement(self.motion.displacement_of(k)), self.weights) for k in rows]
        return np.array(found)

    def alpha_to_see(self) -> float:
        """Return the run's suggested α (`result.advice`); 0 without a magnified mode."""
        return 0.0 if self.strongest() is None else result_of(Run.open(self.path)).alpha


def open_scene(run: Run) -> RunScene:
    """Read a run for display. Raises RunError if its space stage is not finished, or a file is damaged.

    Without the dataset there are no cameras to jump to, and its scale is unknown; a note says so.
    """
    gaussians, motion, deviation = run.load_space(), run.load_motion(), run.load_uncertainty()
    means, notes = gaussians.means.numpy(), []
    if motion is None:
        notes.append("This run has no motion: the scene is shown at rest.")
    elif not motion.is_magnified().any():
        notes.append("No frequency was found in this run: there is nothing to magnify.")
    try:
        capture = load_capture(run.dataset)
    except CaptureError as error:
        weights = gaussians.opacities.numpy().astype(np.float64)
        lines = (*notes, f"No cameras of the capture: {error}")
        return RunScene(
            run.path, gaussians, motion, weights, deviation, (overview(means),), *unit_of(None), lines
        )
    cameras, weights = capture_cameras(capture), blending_weights(gaussians, _few_cameras(capture))
    look = None if capture.kind.sees_depth else look_of(run)
    filmed = Filmed(capture, middle_depth(means, weights, cameras[0]))
    return RunScene(
        run.path,
        gaussians,
        motion,
        weights,
        deviation,
        cameras,
        *unit_of(capture),
        tuple(notes),
        look,
        filmed,
    )


def _few_cameras(capture: Capture) -> Capture:
    """Return one picture of each of some cameras, evenly picked."""
    _, first = np.unique(capture.camera_ids, return_index=True)
    return capture.selected(first[evenly(len(first), _LOOKED_FROM)])
