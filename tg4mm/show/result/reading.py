"""The files of a run that its `Result` is read from, and how far a magnified motion goes.

A displacement is magnified exactly, whatever α is. What ends the use of it is noise, which grows along, and turning: a
turn by θ is drawn as a displacement that grows with the distance from its axis, so a part that turns by θ gets
√(1 + θ²) times as large (12 % at half a radian), and where neighbours move apart by their own distance, surfaces tear.
Both are told by the same number, what the displacement changes by from one Gaussian to the next, per distance.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.look import Found
from tg4mm.capture.scene import between_frames
from tg4mm.core.errors import RunError
from tg4mm.core.phasors import peak_displacement, scale_top
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.amplitude_bias import LACKING
from tg4mm.fit.motion.mode_selection import worth_keeping
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import frames_of
from tg4mm.run import Run
from tg4mm.run.checks import check_readout, check_times
from tg4mm.run.stages import look_of
from tg4mm.show.maps import blending_weights
from tg4mm.show.result.model import Length

TURN = 0.5  # radians, or displacement per distance: from here on shapes stretch by 12 % and more
NOISE_PX = 1.0  # noise of a pixel is seen as motion
_NEIGHBOURS = 6
_TOP = 0.99  # of what is seen
_LARGEST = 0.99  # of the weight of what is seen lies below the amplitude that is named, as in pixels
_HELD_STILL = 1e-6  # of the largest noise: less is of Gaussians that the fit holds still


@dataclass(frozen=True)
class Reach:
    """How far a motion may be magnified."""

    pixels: float | None  # the largest motion; None without a camera
    noise_px: float | None  # the noise's amplitude; None where it is not known
    turn: float  # radians, and what the displacement changes by per distance: the larger

    @property
    def too_far(self) -> float:
        """How many times as large as it should be at most; up to 1 it is within its limits."""
        return max(self.turn / TURN, (self.noise_px or 0.0) / NOISE_PX)


def reach_of(
    gaussians: Gaussians,
    motion: ModalMotion,
    seen: "Seen",
    noise_px: float | None,
    gains: np.ndarray,
    is_decoded: bool = False,
) -> Reach:
    """Return the reach of the modes as `gains` [K] multiplies them; 0: a mode that does not count. noise_px: at gain 1.

    `is_decoded`: magnified poses come from a network (`paper`), for which phasors do not stand. That turns single
    Gaussians by radians where nothing in the scene turns, so that turning and shearing tell no limit: turn is 0.
    Modes of different frequencies are added as powers: their peaks seldom meet.
    """
    means = gaussians.means.numpy()
    rows = np.flatnonzero(seen.weights > 0)
    distance, near = _neighbours(means[rows], gaussians.scales.numpy()[rows].max(1))
    pixels2, strain2, turn2 = 0.0, np.zeros(len(rows)), np.zeros(len(rows))
    for k in np.flatnonzero(gains):
        moved, turned = (gains[k] * phasors[k] for phasors in (motion.displacement, motion.rotation))
        pixels2 += (seen.pixels(moved) or 0.0) ** 2
        if is_decoded:
            continue
        apart = moved[rows][near] - moved[rows][:, None]
        strain2 += _second_largest((np.abs(apart) ** 2).sum(-1) / distance**2)
        turn2 += peak_displacement(turned[rows]) ** 2
    strains = np.sqrt(np.maximum(strain2, turn2))
    return Reach(
        pixels=float(np.sqrt(pixels2)) if seen.rows else None,
        noise_px=None if noise_px is None else noise_px * float(np.abs(gains).max(initial=0)),
        turn=scale_top(strains, seen.weights[rows], _TOP) if len(rows) else 0.0,
    )


def _second_largest(values: np.ndarray) -> np.ndarray:
    """[n] of values [n, k]: to neighbours across the gradient there is no difference, and the largest may be stray."""
    return np.asarray(np.sort(values, axis=1)[:, -min(2, values.shape[1])])


def _neighbours(means: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances [n, k] and indices [n, k] of the nearest; never nearer than a Gaussian is large."""
    count = min(_NEIGHBOURS + 1, len(means))
    if count < 2:
        return np.ones((len(means), 1)), np.zeros((len(means), 1), int)
    distance, near = cKDTree(means).query(means, k=count)
    return np.maximum(distance[:, 1:], np.maximum(sizes, 1e-12)[:, None]), near[:, 1:]


_CAMERAS = 4  # looked at, spread evenly over those that show motion


@dataclass(frozen=True)
class Seen:
    """Blending weights, and for each camera the rows [N, 2, 3] that turn a displacement (scene units) into pixels."""

    weights: np.ndarray  # [N]
    rows: tuple[np.ndarray, ...]  # 0 where a camera does not see the Gaussian; () without a dataset
    inside: tuple[np.ndarray, ...]  # [N] bool of each camera

    def pixels(self, phasors: np.ndarray) -> float | None:
        """Amplitude in pixels of phasors [N, 3] complex: 99th percentile of what is seen; None without a camera."""
        if not self.rows:
            return None
        amplitudes = [peak_displacement(np.einsum("nab,nb->na", row, phasors)) for row in self.rows]
        return scale_top(np.concatenate(amplitudes), np.concatenate(self._weights()), _TOP)

    def rms_pixels(self, covariance: np.ndarray) -> float | None:
        """Standard deviation across the pictures, rms over what is seen, of a displacement's covariance [N, 3, 3]."""
        if not self.rows:
            return None
        variances = [np.einsum("nab,nbc,nac->n", row, covariance, row) for row in self.rows]
        weights = np.concatenate(self._weights())
        return float(np.sqrt((weights * np.concatenate(variances)).sum() / max(weights.sum(), 1e-30)))

    def _weights(self) -> list[np.ndarray]:
        return [self.weights * inside for inside in self.inside]


def seen_by(gaussians: Gaussians, capture: Capture | None) -> Seen:
    """By up to four of the cameras that show motion; without a capture all Gaussians count by their opacity."""
    if capture is None:
        return Seen(gaussians.opacities.numpy().astype(np.float64), (), ())
    _, frames = frames_of(capture)
    some = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, _CAMERAS).round().astype(int))]
    chosen = np.array([f.rows[0] for f in some])
    weights = blending_weights(gaussians, capture.selected(chosen))
    means = gaussians.means.numpy().astype(np.float64)
    projected = [pixel_rows(means, f.viewmat, f.K, (capture.width, capture.height)) for f in some]
    return Seen(weights, tuple(p[0] for p in projected), tuple(p[1] for p in projected))


def pixel_rows(
    means: np.ndarray, viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Derivative [N, 2, 3] of the pixel by the position of points [N, 3], and whether they lie in the picture [N]."""
    x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).T
    front = z > 1e-6
    z = np.where(front, z, 1.0)
    u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
    inside = front & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
    zero = np.zeros_like(z)
    by_camera = np.stack(
        [
            np.stack([K[0, 0] / z, zero, -K[0, 0] * x / z**2], -1),
            np.stack([zero, K[1, 1] / z, -K[1, 1] * y / z**2], -1),
        ],
        1,
    )
    return np.where(inside[:, None, None], by_camera @ viewmat[:3, :3].astype(np.float64), 0.0), inside


def reading_of(run: Run) -> "Reading":
    """The files of a run. Raises RunError for one that is not finished, or whose dataset has other times now."""
    motion = run.load_motion()
    capture = load_capture(run.dataset) if run.dataset.is_dir() else None
    if motion is None and capture is not None and capture.n_timesteps > 1:
        raise RunError(f"{run.path} has no motion.safetensors: its motion stage is not finished")
    if motion is not None and capture is not None:
        of_run, of_dataset = (motion.fps, motion.n_timesteps), (capture.fps, capture.n_timesteps)
        check_times(run.path, run.dataset, of_run, of_dataset)
        check_readout(run.path, run.dataset, run.log().get("motion", {}), capture.rows_s)
    uncertainty = run.load_uncertainties() if motion is not None else {}
    return Reading(run, run.load_space(), motion, run.log().get("motion", {}), capture, uncertainty)


@dataclass(frozen=True)
class Reading:
    """The files of a run that a result is read from."""

    run: Run
    gaussians: Gaussians
    motion: ModalMotion | None
    log: dict[str, Any]  # of the motion stage
    capture: Capture | None  # None: the dataset is gone
    uncertainty: dict[str, np.ndarray]  # {}: the run does not say it

    @property
    def duration_s(self) -> float:
        """The duration of the record, with frames that are missing. 0 for a run without motion."""
        if self.motion is None:
            return 0.0
        return float(self.log.get("duration_s") or self.motion.n_timesteps / self.motion.fps)

    @cached_property
    def seen(self) -> Seen:
        return seen_by(self.gaussians, self.capture)

    @cached_property
    def between(self) -> np.ndarray | None:
        """[T] bool: frames that a codec predicts from both sides; None where that is not known."""
        if self.capture is None or self.motion is None:
            return None
        return between_frames(self.capture.root, self.motion.n_timesteps)

    @cached_property
    def look(self) -> Found | None:
        """What the look at the one fixed camera's regions found."""
        return None if self.capture is None else look_of(self.run)

    def largest(
        self, phasors: np.ndarray, deviation: np.ndarray | None
    ) -> tuple[Length, tuple[float, float, float]]:
        amplitude = peak_displacement(phasors)
        top = scale_top(amplitude, self.seen.weights, _LARGEST)
        there = int(np.argmin(np.where(self.seen.weights > 0, np.abs(amplitude - top), np.inf)))
        x, y, z = (float(c) for c in self.gaussians.means[there])
        return Length(top, None if deviation is None else float(deviation[there])), (x, y, z)

    def pixel(self, place: tuple[float, float, float]) -> tuple[float, float] | None:
        """Return, for a flat capture, where a place lies in its picture."""
        if self.capture is None or self.capture.kind.sees_depth:
            return None
        viewmat, K = self.capture.viewmats[0].astype(np.float64), self.capture.Ks[0].astype(np.float64)
        x, y, z = K @ (viewmat[:3, :3] @ np.array(place) + viewmat[:3, 3])
        return float(x / z), float(y / z)

    def pixels(self, phasors: np.ndarray, amplitude: Length) -> Length | None:
        """Return the deviation in pixels: relative to the motion it is that in scene units.

        What lies along the line of sight is left out.
        """
        pixels = self.seen.pixels(phasors)
        if pixels is None or amplitude.deviation is None or not amplitude.value > 0:
            return None if pixels is None else Length(pixels, is_bound=amplitude.is_bound)
        deviation = pixels * amplitude.deviation / amplitude.value
        if "covariance" in self.uncertainty:
            own = self.uncertainty["covariance"].astype(np.float64)
            even = np.trace(own, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
            deviation *= (self.seen.rms_pixels(own) or 0.0) / max(self.seen.rms_pixels(even) or 0.0, 1e-30)
        return Length(pixels, deviation, amplitude.is_bound)

    def is_bound(self, hz: float) -> bool:
        """Whether more may move than the model holds, by what the fit says of itself."""
        slow = np.array(self.log.get("lower_bound_hz", ()))
        return bool(
            self.log.get("picture_gain", 1.0) > LACKING or (np.abs(slow - hz) < 1 / self.duration_s).any()
        )

    def noise(self) -> tuple[float | None, float | None]:
        if "noise" not in self.uncertainty:
            return None, None
        noise = self.uncertainty["noise"].astype(np.float64)
        moves = noise > _HELD_STILL * noise.max(initial=0.0)
        own = np.sqrt(2) * scale_top(noise, np.where(moves, self.seen.weights, 0), 0.5)
        pixels = self.seen.rms_pixels((noise**2 / 3)[:, None, None] * np.eye(3))
        return own, None if pixels is None else np.sqrt(2) * pixels

    def reach(self, gains: np.ndarray) -> Reach | None:
        """How far the motion goes with its modes multiplied by `gains` [K]; None for a run without motion."""
        if self.motion is None:
            return None
        told = worth_keeping(self.motion, self.uncertainty.get("noise"))
        noise_px, is_decoded = self.noise()[1], self.run.preset != "modal"
        return reach_of(self.gaussians, self.motion, self.seen, noise_px, gains * told, is_decoded)
