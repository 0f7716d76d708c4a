"""A steady vibration, as cameras with clocks of their own and a moving camera see it: a few sinusoids.

Their frequencies are found first, from how regions of Gaussians shift in the pictures; then every frequency has two
fields, of its cosine and its sine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from tg4mm.fit.motion.jacobian.pixels import pixels_moved
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.split_half import reliability
from tg4mm.fit.motion.targets import TargetImages
from tg4mm.fit.motion.temporal import TemporalModel
from tg4mm.fit.motion.temporal.frequencies import Frequencies, find_frequencies
from tg4mm.fit.motion.temporal.regions import RegionSeries

_HIGHEST = 0.98  # of half the frame rate


@dataclass(frozen=True)
class Steady(TemporalModel):
    """Functions 2k and 2k + 1 of time are cosine and −sine of frequency k; further ones are no motion."""

    frequencies: Frequencies
    scale: float  # of the cosines and sines: fields times it are phasors
    min_reliability: ClassVar[float]  # reliability below which a frequency is noise

    @property
    def hz(self) -> np.ndarray:
        """[K], by falling strength."""
        return self.frequencies.hz

    def settled(self, folds: np.ndarray) -> tuple[Self, np.ndarray]:
        """The frequencies' fields, of those on which two folds agree."""
        folds = self.fix_gauge(folds[:, : 2 * len(self.hz)])
        is_reliable = _reliability_of_pairs(folds) >= self.min_reliability
        return self._with(is_reliable), folds[:, np.repeat(is_reliable, 2)]

    def _with(self, keep: np.ndarray) -> Self:
        """Only the frequencies `keep` [K] bool; the log names all where none is kept."""
        rows, frequencies = np.repeat(keep, 2), self.frequencies.selected(keep)
        mixing = [m[:, : len(rows)][:, rows] for m in self.problem.mixing or ()]
        return replace(
            self,
            frequencies=frequencies,
            problem=self.problem.changed(mixing=mixing),
            figures=self.figures | frequency_figures(frequencies) if keep.any() else self.figures,
        )

    def fix_gauge(self, folds: np.ndarray) -> np.ndarray:
        """Fields [P, 2K, N, 6], whose gauge is fixed: what the cameras leave open is chosen."""
        return folds

    def pixels_moved(self, fields: np.ndarray) -> float:
        """By the strongest frequency."""
        return float(np.hypot(*pixels_moved(self.problem.views, fields[:2, :, :3] * np.float32(self.scale))))

    def peaks_hz(self, motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
        return self.hz

    def motion(self, fields: np.ndarray, appearance: np.ndarray | None) -> ModalMotion:
        """By ascending frequency."""
        values = (self.scale * (fields[0::2] + 1j * fields[1::2])).astype(np.complex64)
        order = np.argsort(self.hz)
        of_time = self.observations.fps, self.observations.n_timesteps
        return ModalMotion(
            np.asarray(self.hz, np.float64)[order], values[order, :, :3], values[order, :, 3:], *of_time
        )


def frequencies_of(
    observations: Observations, series: Sequence[RegionSeries], least: float, lowest_hz: float
) -> Frequencies:
    """From all clocks' region shifts, from two periods in the record (or `lowest_hz`) to half the frame rate.

    Those whose power is at least `least` times that of the noise.
    """
    highest = _HIGHEST * observations.fps / 2
    shifts, times = [s.whitened() for s in series], [s.times_s for s in series]
    return find_frequencies(shifts, times, max(lowest_hz, observations.lowest_hz), highest, least)


def frequency_figures(frequencies: Frequencies) -> dict[str, Any]:
    """For the log."""
    return {
        "frequencies_hz": [round(float(f), 4) for f in frequencies.hz],
        "frequency_deviation_hz": [round(float(f), 5) for f in frequencies.deviation_hz],
    }


def no_targets(observations: Observations) -> TargetImages:
    """Where there is no function of time."""
    n, (width, height) = len(observations.frames), observations.size
    nothing = np.zeros((n, 0, height, width, 3), np.float32)
    basis, blank = np.zeros((0, observations.n_timesteps)), np.zeros((n, height, width), np.float32)
    return TargetImages(basis, np.zeros(observations.n_timesteps), nothing, blank, 1, nothing[:, 0:0])


def _reliability_of_pairs(folds: np.ndarray) -> np.ndarray:
    """[K] of each frequency's sine and cosine together, of the fields [2, 2K, N, 6] of two halves; 1 of one fold."""
    if len(folds) == 1:
        return np.ones(folds.shape[1] // 2)
    a, b = (half[..., :3].reshape(half.shape[0] // 2, -1, 3) for half in folds)
    return reliability((a + b) / 2, a, b)
