"""The files of a run from which its `Result` is read, and the limits of magnification.

A displacement is magnified exactly for any α. The limits are noise, which is magnified too, and rotation: a turn by θ
is drawn as a displacement that grows with the distance from its axis, so that a part that turns by θ becomes √(1 + θ²)
times as large (12 % at half a radian), and surfaces tear if neighbours move apart by their distance. The difference
of displacement between neighbouring Gaussians, per distance, shows both.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.look import LookSummary
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
from tg4mm.show.maps import blending_weights, evenly, pixel_rows
from tg4mm.show.result.model import Length, mode_deviations

TURN = 0.5  # radians, or displacement per distance, beyond which shapes stretch by 12 % and more
NOISE_PX = 1.0  # noise of a pixel looks like motion
_NEIGHBOURS = 6
_TOP = 0.99  # of the visible weight lies below a reported amplitude
_FROZEN = 1e-6  # of the largest noise: less belongs to Gaussians that the fit keeps static
_CAMERAS = 4  # spread evenly over those that show motion


@dataclass(frozen=True)
class MagnificationLimits:
    """Limits on the magnification of a motion."""

    pixels: float | None  # the largest motion; None without a camera
    noise_px: float | None  # the noise's amplitude; None if unknown
    turn: float  # the larger of rotation (radians) and displacement gradient

    @property
    def too_far(self) -> float:
        """The motion over its limit; at most 1 within it."""
        return max(self.turn / TURN, (self.noise_px or 0.0) / NOISE_PX)


def reach_of(
    gaussians: Gaussians,
    motion: ModalMotion,
    seen: "Visibility",
    noise_px: float | None,
    gains: np.ndarray,
    is_decoded: bool = False,
) -> MagnificationLimits:
    """Return the reach of the modes multiplied by `gains` [K]; 0 excludes a mode. noise_px: at gain 1.

    `is_decoded`: magnified poses come from a network (`paper`), not from phasors. It turns single Gaussians by radians
    where nothing in the scene turns, so that rotation and shear give no limit: turn is 0. Modes of different
    frequencies are added as powers: their peaks rarely coincide.
    """
    means = gaussians.means.numpy()
    rows = np.flatnonzero(seen.weights > 0)
    distance, near = _neighbours(means[rows], gaussians.scales.numpy()[rows].max(1))
    pixels2, strain2, turn2 = 0.0, np.zeros(len(rows)), np.zeros(len(rows))
    for k in np.flatnonzero(gains):
        moved, turned = gains[k] * motion.displacement_of(k), gains[k] * motion.rotation_of(k)
        pixels2 += (seen.pixels(moved) or 0.0) ** 2
        if is_decoded:
            continue
        apart = moved[rows][near] - moved[rows][:, None]
        strain2 += _second_largest((np.abs(apart) ** 2).sum(-1) / distance**2)
        turn2 += peak_displacement(turned[rows]) ** 2
    strains = np.sqrt(np.maximum(strain2, turn2))
    return MagnificationLimits(
        pixels=float(np.sqrt(pixels2)) if seen.rows else None,
        noise_px=None if noise_px is None else noise_px * float(np.abs(gains).max(initial=0)),
        turn=scale_top(strains, seen.weights[rows], _TOP) if len(rows) else 0.0,
    )


def _second_largest(values: np.ndarray) -> np.ndarray:
    """Return the second largest of values [n, k], [n]: the largest may be an outlier."""
    return np.asarray(np.sort(values, axis=1)[:, -min(2, values.shape[1])])


def _neighbours(means: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances [n, k] and indices [n, k] of the nearest points; distances are at least a Gaussian's size."""
    count = min(_NEIGHBOURS + 1, len(means))
    if count < 2:
        return np.ones((len(means), 1)), np.zeros((len(means), 1), int)
    distance, near = cKDTree(means).query(means, k=count)
    return np.maximum(distance[:, 1:], np.maximum(sizes, 1e-12)[:, None]), near[:, 1:]


@dataclass(frozen=True)
class Visibility:
    """Blending weights, and for each camera the rows [N, 2, 3] that convert a displacement (scene units) to pixels."""

    weights: np.ndarray  # [N]
    rows: tuple[np.ndarray, ...]  # 0 where a camera does not see the Gaussian; () without a dataset
    inside: tuple[np.ndarray, ...]  # [N] bool for each camera

    def pixels(self, phasors: np.ndarray) -> float | None:
        """Return the amplitude in pixels of phasors [N, 3]: 99th percentile of the visible; None without a camera."""
        if not self.rows:
            return None
        amplitudes = [peak_displacement(np.einsum("nab,nb->na", row, phasors)) for row in self.rows]
        return scale_top(np.concatenate(amplitudes), np.concatenate(self._weights()), _TOP)

    def rms_pixels(self, covariance: np.ndarray) -> float | None:
        """Return the rms deviation in the pictures of a displacement's covariance [N, 3, 3], over the visible."""
        if not self.rows:
            return None
        variances = [np.einsum("nab,nbc,nac->n", row, covariance, row) for row in self.rows]
        weights = np.concatenate(self._weights())
        return float(np.sqrt((weights * np.concatenate(variances)).sum() / max(weights.sum(), 1e-30)))

    def _weights(self) -> list[np.ndarray]:
        return [self.weights * inside for inside in self.inside]


def seen_by(gaussians: Gaussians, capture: Capture | None) -> Visibility:
    """Return the weights by up to four of the cameras that show motion; without a capture, the opacities."""
    if capture is None:
        return Visibility(gaussians.opacities.numpy().astype(np.float64), (), ())
    _, frames = frames_of(capture)
    some = [frames[i] for i in evenly(len(frames), _CAMERAS)]
    chosen = np.array([f.rows[0] for f in some])
    weights = blending_weights(gaussians, capture.selected(chosen))
    means = gaussians.means.numpy().astype(np.float64)
    projected = [pixel_rows(means, f.viewmat, f.K, (capture.width, capture.height)) for f in some]
    return Visibility(weights, tuple(p[0] for p in projected), tuple(p[1] for p in projected))


def reading_of(run: Run) -> "ResultSources":
    """Read the files of a run. Raises RunError if it is not finished, or its dataset has other times now."""
    motion = run.load_motion()
    capture = load_capture(run.dataset) if run.dataset.is_dir() else None
    if motion is None and capture is not None and capture.n_timesteps > 1:
        raise RunError(f"{run.path} has no motion.safetensors: its motion stage is not finished")
    if motion is not None and capture is not None:
        of_run, of_dataset = (motion.fps, motion.n_timesteps), (capture.fps, capture.n_timesteps)
        check_times(run.path, run.dataset, of_run, of_dataset)
        check_readout(run.path, run.dataset, run.log().get("motion", {}), capture.rows_s)
    uncertainty = run.load_uncertainties() if motion is not None else {}
    return ResultSources(run, run.load_space(), motion, run.log().get("motion", {}), capture, uncertainty)


@dataclass(frozen=True)
class ResultSources:
    """The files of a run from which a result is read."""

    run: Run
    gaussians: Gaussians
    motion: ModalMotion | None
    log: dict[str, Any]  # of the motion stage
    capture: Capture | None  # None: the dataset is gone
    uncertainty: dict[str, np.ndarray]  # {} if the run has none

    @property
    def duration_s(self) -> float:
        """The duration of the record, with frames that are missing. 0 for a run without motion."""
        if self.motion is None:
            return 0.0
        return float(self.log.get("duration_s") or self.motion.n_timesteps / self.motion.fps)

    @cached_property
    def seen(self) -> Visibility:
        return seen_by(self.gaussians, self.capture)

    @cached_property
    def b_frames(self) -> np.ndarray | None:
        """Return [T] bool: B-frames; None if unknown."""
        if self.capture is None or self.motion is None:
            return None
        return between_frames(self.capture.root, self.motion.n_timesteps)

    @cached_property
    def look(self) -> LookSummary | None:
        """The result of the look at the one fixed camera's regions."""
        return None if self.capture is None else look_of(self.run)

    @cached_property
    def _deviations(self) -> np.ndarray | None:
        """Return [K, N] of the modes' amplitudes; None if unknown."""
        if self.motion is None or "noise" not in self.uncertainty:
            return None
        return mode_deviations(self.motion, self.uncertainty["displacement"], self.uncertainty["noise"])

    def largest(self, phasors: np.ndarray, mode: int) -> tuple[Length, tuple[float, float, float]]:
        """Return the largest amplitude (99th percentile of the visible) of a mode and its position, scene units."""
        deviation = None if self._deviations is None else self._deviations[mode]
        amplitude = peak_displacement(phasors)
        top = scale_top(amplitude, self.seen.weights, _TOP)
        there = int(np.argmin(np.where(self.seen.weights > 0, np.abs(amplitude - top), np.inf)))
        x, y, z = (float(c) for c in self.gaussians.means[there])
        return Length(top, None if deviation is None else float(deviation[there])), (x, y, z)

    def pixel(self, position: tuple[float, float, float]) -> tuple[float, float] | None:
        """Return the pixel of a position in a flat capture."""
        if self.capture is None or self.capture.kind.sees_depth:
            return None
        viewmat, K = self.capture.viewmats[0].astype(np.float64), self.capture.Ks[0].astype(np.float64)
        x, y, z = K @ (viewmat[:3, :3] @ np.array(position) + viewmat[:3, 3])
        return float(x / z), float(y / z)

    def pixels(self, phasors: np.ndarray, amplitude: Length) -> Length | None:
        """Return an amplitude in pixels; its relative deviation is that in scene units without the line of sight."""
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
        """Return whether the fit states that its amplitude is a lower bound."""
        slow = np.array(self.log.get("lower_bound_hz", ()))
        is_near = bool((np.abs(slow - hz) < 1 / self.duration_s).any())
        return is_near or self.log.get("picture_gain", 1.0) > LACKING

    def noise(self) -> tuple[float | None, float | None]:
        """Return the noise's amplitude in scene units (median of the visible) and in pixels; None if unknown."""
        if "noise" not in self.uncertainty:
            return None, None
        noise = self.uncertainty["noise"].astype(np.float64)
        moves = noise > _FROZEN * noise.max(initial=0.0)
        own = np.sqrt(2) * scale_top(noise, np.where(moves, self.seen.weights, 0), 0.5)
        pixels = self.seen.rms_pixels((noise**2 / 3)[:, None, None] * np.eye(3))
        return own, None if pixels is None else np.sqrt(2) * pixels

    def limits(self, gains: np.ndarray) -> MagnificationLimits | None:
        """Return the reach with the modes multiplied by `gains` [K]; None for a run without motion."""
        if self.motion is None:
            return None
        gains = gains * worth_keeping(self.motion, self.uncertainty.get("noise"))
        return reach_of(
            self.gaussians, self.motion, self.seen, self.noise()[1], gains, self.run.preset != "modal"
        )
