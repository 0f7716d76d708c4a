"""The noise that lines stand in: its level over frequency, and what it does to a least-squares fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

AROUND = 6  # bins to either side of a line whose residual tells its noise
_WIDEST, _NARROWEST = 40, 8  # bins to either side that tell the level where lines are looked for
_TRIMMED = 0.2  # of the bins, the strongest: lines that are still there
_ROUNDING = 1e-14  # of the power


def gridded(values: np.ndarray, t: np.ndarray, length: int) -> np.ndarray:
    """[length, D]: values [T, D] put on an even clock, 0 where no sample is."""
    step = float(np.median(np.diff(t)))
    out = np.zeros((length, values.shape[1]))
    np.add.at(out, np.minimum(np.rint((t - t[0]) / step).astype(int), length - 1), values)
    return out


def samples(t: np.ndarray) -> int:
    """Of the even clock that the times lie on."""
    return round(float(np.ptp(t)) / float(np.median(np.diff(t)))) + 1


def spectra(values: np.ndarray, t: np.ndarray) -> NDArray[np.complex128]:
    """[F, D] at bins 1 … F below half the rate; |·|² is the variance of white noise."""
    n = samples(t)
    return np.fft.rfft(gridded(values, t, n), axis=0)[1 : (n + 1) // 2] / np.sqrt(len(t))


def level(power: np.ndarray) -> np.ndarray:
    """[F, D] the noise's level in power [F, D]: a smooth fall with frequency, times a trimmed mean of its surroundings.

    The strongest fifth of the bins is left out, as lines may be, and what exponentially distributed power loses by
    that is made up for.
    """
    floor = np.maximum(power, _ROUNDING * max(float(power.max(initial=0)), 1e-300))
    bins = np.arange(1, len(power) + 1)
    half = int(np.clip(len(power) // 6, min(_NARROWEST, len(power) // 2), _WIDEST))
    out = np.empty_like(floor)
    for d in range(power.shape[1]):
        fall = _fall(floor[:, d], bins)
        padded = np.pad(floor[:, d] / fall, half, mode="reflect") if half else floor[:, d] / fall
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
        kept = max(int(np.ceil((1 - _TRIMMED) * windows.shape[1])), 1)
        out[:, d] = np.sort(windows, axis=1)[:, :kept].mean(1) / _trimmed_mean(kept / windows.shape[1]) * fall
    return out


def degrees(n_bins: int) -> int:
    """Of freedom that `level` has, about."""
    half = int(np.clip(n_bins // 6, min(_NARROWEST, n_bins // 2), _WIDEST))
    return max(int(2 * (1 - _TRIMMED) * (2 * half + 1)), 2)


def _trimmed_mean(share: float) -> float:
    """Of the weakest `share` of exponentially distributed numbers of mean 1."""
    if share >= 1:
        return 1.0
    return float(1 + (1 - share) * np.log(1 - share) / share)


def _fall(power: np.ndarray, bins: np.ndarray) -> np.ndarray:
    """[F] a parabola through the logarithm over log frequency, peaks clipped."""
    if len(power) < 3 * _NARROWEST:
        return np.full(len(power), float(power.mean()))
    x, y = np.log(bins), np.log(power)
    kept = np.ones(len(y), bool)
    for _ in range(6):
        fitted = np.polyval(np.polyfit(x[kept], y[kept], 2), x)
        spread = 1.4826 * float(np.median(np.abs(y - fitted)[kept]))
        kept = y - fitted < max(2 * spread, 1e-6)
    return np.asarray(np.exp(fitted))


def around(power: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """[F, D]: the mean of power [F, D] over 2·6 + 1 bins, for as many as the fit has taken from each [F] made up."""
    half = min(AROUND, max((len(power) - 1) // 2, 0))
    kernel = np.ones(2 * half + 1)

    def summed(v: np.ndarray) -> np.ndarray:
        return np.convolve(np.pad(v, half, mode="reflect") if half else v, kernel, "valid")

    left = np.maximum(summed(1 - taken), 1.0)
    return np.stack([summed(p) / left for p in power.T], 1)


def sandwiched(columns: np.ndarray, levels: np.ndarray, t: np.ndarray) -> np.ndarray:
    """[P, P] XᵀΣX of columns X [T, D, P] for noise of level [F, D], not correlated between components."""
    n = samples(t)
    out = np.zeros((columns.shape[2],) * 2)
    for d in range(columns.shape[1]):
        own = np.fft.rfft(gridded(columns[:, d], t, 2 * n), axis=0)
        hz = np.arange(len(own)) / 2  # bins
        density = np.interp(hz, np.arange(1, len(levels) + 1), levels[:, d])
        twice = np.where((hz == 0) | (hz == n / 2), 1.0, 2.0)  # the mirror image
        weighted = own * (density * twice)[:, None]
        out += (own.conj().T @ weighted).real / (2 * n)
    return out
