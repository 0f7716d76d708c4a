"""The files of a run that its `Result` is read from, and what they say of a motion's size."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.look import Found
from tg4mm.capture.scene import between_frames
from tg4mm.core.errors import RunError
from tg4mm.core.phasors import peak_displacement, scale_top
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.mode_selection import worth_keeping
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.picture_gain import LACKING
from tg4mm.run import Run
from tg4mm.run.checks import check_readout, check_times
from tg4mm.run.stages.look import look_of
from tg4mm.show.result.model import Length
from tg4mm.show.result.reach import Reach, Seen, reach_of, seen_by

_LARGEST = 0.99  # of the weight of what is seen lies below the amplitude that is named, as in pixels
_HELD_STILL = 1e-6  # of the largest noise: less is of Gaussians that the fit holds still


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
