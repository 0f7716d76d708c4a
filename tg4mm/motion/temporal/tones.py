"""Which frequencies a motion has, wherever they lie between the bins of a Fourier transform.

A capture seldom holds whole periods. Then a sinusoid spreads over all bins, so a band around it holds but a part, and
the mean over time, where the Gaussians lie, is not the motion's zero. A drift spreads likewise, into every band. So the
functions of time are fitted by sinusoids of free frequencies, a constant, and where there is one a slow trend, the
frequencies by least squares with all else projected out (variable projection), one after the other by the highest peak
of what is left. Where bins do as well (whole periods, or nothing that is tonal) there are no tones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

SLOW_TURN = 0.05  # bins: a sine so slow that over the capture it is a straight line within half a percent
_MOST = 8  # tones
_WEAKEST = 1e-4  # of the power: weaker tones stay in the bins
_PEAK = 10.0  # times the part that one dimension of broadband motion holds: what counts as a peak
_BETTER = 0.5  # of what as many bins and one leave: tones must leave less
_APART = 0.75  # bins between tones, from 0 Hz but for one bin, and from half the frame rate
_ON_BIN = 0.01  # bins: nearer to one than this is on it
_OVERSAMPLED = 8


@dataclass(frozen=True)
class Tones:
    """Frequencies in bins (cycles per capture), ascending, and whether there is a trend beside them."""

    cycles: np.ndarray  # [J] float64
    trend: bool = False

    def regressors(self, n_timesteps: int) -> np.ndarray:
        """[T, P]: a constant, the trend if any (zero at timestep 0), cosines, sines."""
        turns = np.arange(n_timesteps) / n_timesteps
        angles = 2 * np.pi * turns[:, None] * self.cycles
        slow = [np.sin(2 * np.pi * SLOW_TURN * turns)[:, None]] if self.trend else []
        return np.hstack([np.ones((n_timesteps, 1)), *slow, np.cos(angles), np.sin(angles)])


def found_tones(series: np.ndarray) -> Tones:
    """The tones of real functions of time [R, T] that share their frequencies, stronger ones counting more.

    None where Fourier bins describe them as well. The mean over time is no part of it.
    """
    y = (series - series.mean(1, keepdims=True)).T
    power = float((y**2).sum())
    none = Tones(np.zeros(0))
    if len(y) < _OVERSAMPLED or not power > 0:
        return none
    plain, straight = _greedy(y, trend=False), _greedy(y, trend=True)
    left_plain, left_straight = _left(y, plain), _left(y, straight)
    tones, left = plain, left_plain
    if left_straight < _BETTER * left_plain and left_plain - left_straight > _WEAKEST * power:
        tones, left = straight, left_straight
    by_bins = np.sort((np.abs(np.fft.rfft(y, axis=0)) ** 2).sum(1))[::-1] * 2 / len(y)
    as_many = float(np.maximum(power - by_bins[: len(tones.cycles) + 1].sum(), 0))
    is_better = left < _BETTER * as_many and as_many - left > _WEAKEST * power
    return _on_bins(tones) if is_better else none


def _left(y: np.ndarray, tones: Tones) -> float:
    return float((_residual(y, tones) ** 2).sum())


def _residual(y: np.ndarray, tones: Tones) -> np.ndarray:
    """What the best combination of the tones leaves of y [T, R]."""
    x = tones.regressors(len(y))
    return np.asarray(y - x @ np.linalg.lstsq(x, y, rcond=None)[0])


def _greedy(y: np.ndarray, trend: bool) -> Tones:
    """One tone after the other, all refined each time, until no peak is left."""
    tones, power = Tones(np.zeros(0), trend), float((y**2).sum())
    most = min(_MOST, (len(y) - 2) // 4)
    residual = _residual(y, tones)
    while len(tones.cycles) < most:
        left = float((residual**2).sum())
        peak = _highest_peak(residual, tones.cycles)
        if peak is None or left <= _WEAKEST * power:
            break
        more = _refined(y, Tones(np.append(tones.cycles, peak), trend))
        residual = _residual(y, more)
        gain = left - float((residual**2).sum())
        if not _are_apart(more.cycles, len(y)) or gain < max(_WEAKEST * power, _needed(y, tones) * left):
            break
        tones = more
    return tones


def _needed(y: np.ndarray, tones: Tones) -> float:
    """The part of what is left that a tone must take to be more than chance."""
    free = len(y) - 2 - 2 * len(tones.cycles)
    return min(_PEAK / free, 0.9)


def _highest_peak(residual: np.ndarray, known: np.ndarray) -> float | None:
    """In bins; None if no frequency is far enough from those known."""
    n = len(residual) * _OVERSAMPLED
    height = (np.abs(np.fft.rfft(residual, n, axis=0)) ** 2).sum(1)
    cycles = np.arange(len(height)) / _OVERSAMPLED
    allowed = (cycles >= 1) & (cycles <= len(residual) / 2 - _APART)
    for one in known:
        allowed &= np.abs(cycles - one) >= _APART
    return float(cycles[np.where(allowed, height, -1).argmax()]) if allowed.any() else None


def _refined(y: np.ndarray, tones: Tones) -> Tones:
    """All frequencies moved to where least is left, by at most a bin."""
    scale = float(np.sqrt((y**2).sum()))

    def misfit(cycles: np.ndarray) -> np.ndarray:
        return _residual(y, Tones(cycles, tones.trend)).ravel() / scale

    best = least_squares(
        misfit, tones.cycles, bounds=(tones.cycles - 1, tones.cycles + 1), xtol=1e-10, ftol=1e-12
    )
    return Tones(np.sort(best.x), tones.trend)


def _are_apart(cycles: np.ndarray, n_timesteps: int) -> bool:
    ends = np.array([1 - _ON_BIN - _APART, *cycles, n_timesteps / 2])
    return bool((np.diff(ends) >= _APART).all())


def _on_bins(tones: Tones) -> Tones:
    near = np.round(tones.cycles)
    return Tones(np.where(np.abs(tones.cycles - near) < _ON_BIN, near, tones.cycles), tones.trend)
