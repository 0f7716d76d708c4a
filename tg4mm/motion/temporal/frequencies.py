"""Which frequencies a scene vibrates at, from series of several clocks with times of their own (dropped frames, clips).

Least-squares spectra (Lomb 1976, Scargle 1982) of every region's shift, each in units of its own noise, are averaged
over regions and clocks. A peak that stands out of the other frequencies is a frequency; its sinusoids are fitted to all
series and taken out, and the next is looked for in what is left. All frequencies found are then refined together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

MOST = 6
_OVERSAMPLED = 6  # frequencies tried per 1 / duration
_CAP = 300.0  # of a series' power over its noise: a few that move much do not hide the rest
_STANDS_OUT = 5.0  # robust deviations of the noise's logarithm above it
LEAST = 1.3  # times the noise: weaker peaks are noise, however smooth its spectrum is
_LOUD = 10.0  # times the noise: such a peak has side lobes all over a short record, and is taken out to see the noise
_CLIPS = 8  # rounds in which peaks are left out of the noise
_WEAK = 0.03  # of the strongest peak's power above the floor: weaker is taken for leakage
_THIRDS = 3
_LEAST_CLOCKS = 3  # from which on they tell how much they differ
_APART = (
    1.5  # over the duration, Hz: nearer ones are one whose amplitude changes, as a camera moves around it
)

_Clocks = tuple[Sequence[np.ndarray], Sequence[np.ndarray], Sequence[np.ndarray]]  # series, times, noise


@dataclass(frozen=True)
class Frequencies:
    """Frequencies by falling strength, and the spectrum in which they were found."""

    hz: np.ndarray  # [K]
    deviation_hz: np.ndarray  # [K] standard deviation by noise (Cramér-Rao)
    grid_hz: np.ndarray  # [M]
    spectrum: np.ndarray  # [M] mean power over noise, 1 where there is noise alone

    def selected(self, keep: np.ndarray) -> Frequencies:
        """Some of the frequencies [K] bool."""
        return replace(self, hz=self.hz[keep], deviation_hz=self.deviation_hz[keep])


def find_frequencies(
    series: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    lowest_hz: float,
    highest_hz: float,
    least: float = LEAST,
) -> Frequencies:
    """Of series [F_c, S_c] of each clock at times [F_c] in seconds, between two frequencies.

    A peak counts from `least` times the noise's power.
    """
    duration = max(float(np.ptp(t)) for t in times)
    grid = np.arange(lowest_hz, highest_hz, 1 / (_OVERSAMPLED * duration))
    clean = [_without_slow(y, t, lowest_hz) for y, t in zip(series, times, strict=True)]
    noise = [_noise(y, t, grid) for y, t in zip(clean, times, strict=True)]
    found: list[float] = []
    first: np.ndarray | None = None
    strongest = 0.0
    while len(found) < MOST:
        left = [_without(y, t, np.array(found)) for y, t in zip(clean, times, strict=True)]
        spectrum = _spectrum(left, times, noise, grid)
        first = spectrum if first is None else first
        allowed = np.ones(len(grid), bool)
        for f in found:
            allowed &= np.abs(grid - f) > _APART / duration
        if not allowed.any():
            break
        peak = int(np.where(allowed, spectrum, -1).argmax())
        more = _refined(clean, times, noise, [*found, float(grid[peak])], 1 / duration)
        rest, others = spectrum, allowed
        if spectrum[peak] > _LOUD:
            left = [_without(y, t, np.array(more)) for y, t in zip(clean, times, strict=True)]
            rest = _spectrum(left, times, noise, grid)
            others = allowed & (np.abs(grid - grid[peak]) > _APART / duration)
        if not others.any():
            break
        floor, spread = log_floor(rest, grid, others)
        above = float(np.log(max(spectrum[peak], 1e-12)) - floor[peak])
        power = float(spectrum[peak] - np.exp(floor[peak]))
        strongest = max(strongest, power)
        if above < max(_STANDS_OUT * spread, np.log(least)) or power < _WEAK * strongest:
            break
        if len(more) > 1 and np.diff(np.sort(more)).min() < 0.5 * _APART / duration:
            break
        found = more
    hz = np.array(found)
    assert first is not None
    bound = _deviation(clean, times, noise, hz)
    scatter = _scatter(clean, times, noise, hz, 1 / duration)
    return Frequencies(hz, np.hypot(bound, scatter), grid, first)


def log_floor(spectrum: np.ndarray, grid: np.ndarray, allowed: np.ndarray) -> tuple[np.ndarray, float]:
    """[M] log of the noise's spectrum, a parabola over log frequency, and the robust deviation from it.

    Of the `allowed` frequencies [M] bool. Peaks are clipped: what lies more than two deviations above is left out, and
    the rest is fitted again.
    """
    x, y = np.log(grid / grid[0]), np.log(np.maximum(spectrum, 1e-12))
    kept, spread = allowed, 0.0
    fitted = np.full(len(y), float(np.median(y[allowed])))
    for k in range(_CLIPS):
        if k:
            fitted = np.polyval(np.polyfit(x[kept], y[kept], 2 if kept.sum() > 20 else 0), x)
        left = y - fitted
        spread = 1.4826 * float(np.median(np.abs(left[kept])))
        kept = allowed & (left < max(2 * spread, 1e-6))
    return fitted, spread


def _without_slow(y: np.ndarray, t: np.ndarray, lowest_hz: float) -> np.ndarray:
    """Less a constant and polynomials that turn more slowly than the lowest frequency."""
    degree = max(int(2 * lowest_hz * np.ptp(t) / 2), 1)
    x = np.polynomial.legendre.legvander(2 * (t - t.min()) / max(float(np.ptp(t)), 1e-12) - 1, degree)
    return y - x @ np.linalg.lstsq(x, y, rcond=None)[0]


def _power(y: np.ndarray, t: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """[M, S]: power of each series at each frequency; mean 1 for white noise of variance 1."""
    functions = sinusoids(t, grid)  # [2M, F]
    products = (functions @ y).reshape(len(grid), 2, -1)
    return (products**2).sum(1) / len(t)


def _noise(y: np.ndarray, t: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """[S]: variance of each series' noise, by the median over frequencies (of an exponential distribution)."""
    return np.median(_power(y, t, grid), axis=0) / np.log(2)


def _spectrum(
    series: Sequence[np.ndarray], times: Sequence[np.ndarray], noise: Sequence[np.ndarray], grid: np.ndarray
) -> np.ndarray:
    total, count = np.zeros(len(grid)), 0
    for y, t, n in zip(series, times, noise, strict=True):
        used = n > 0
        total += np.minimum(_power(y[:, used], t, grid) / n[used], _CAP).sum(1)
        count += int(used.sum())
    return total / max(count, 1)


def _without(y: np.ndarray, t: np.ndarray, hz: np.ndarray) -> np.ndarray:
    if not len(hz):
        return y
    x = sinusoids(t, hz).T
    return y - x @ np.linalg.lstsq(x, y, rcond=None)[0]


def _refined(
    series: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    noise: Sequence[np.ndarray],
    hz: list[float],
    step: float,
) -> list[float]:
    """All frequencies moved to where least is left, by at most `step` (variable projection)."""
    weighted = [_strong(y[:, n > 0] / np.sqrt(n[n > 0])) for y, n in zip(series, noise, strict=True)]
    scale = np.sqrt(sum(float((y**2).sum()) for y in weighted)) or 1.0

    def misfit(f: np.ndarray) -> np.ndarray:
        return (
            np.concatenate([_without(y, t, f).ravel() for y, t in zip(weighted, times, strict=True)]) / scale
        )

    start = np.array(hz)
    best = least_squares(
        misfit, start, bounds=(start - step, start + step), xtol=1e-9, ftol=1e-10, max_nfev=30
    )
    return [float(f) for f in best.x]


def _scatter(
    series: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    noise: Sequence[np.ndarray],
    hz: np.ndarray,
    step: float,
) -> np.ndarray:
    """[K]: standard error of the frequencies, from how they differ between clocks and between thirds of the record.

    The larger of the two. What all clips have alike (a codec that follows the motion late after a clip's first picture,
    a vibration that changes) shows in thirds of the record alone.
    """
    if not len(hz):
        return np.zeros(0)

    def deviation(groups: Sequence[_Clocks]) -> np.ndarray:
        each = [_refined(*own, list(hz), step / 2) for own in groups]
        return np.asarray(np.std(np.array(each), axis=0, ddof=1) / np.sqrt(len(groups)))

    thirds = [(*_without_third(series, times, k), noise) for k in range(_THIRDS)]
    within = np.asarray((_THIRDS - 1) * deviation(thirds))  # the jackknife's
    if len(series) < _LEAST_CLOCKS:
        return within
    return np.maximum(
        within, deviation([([y], [t], [n]) for y, t, n in zip(series, times, noise, strict=True)])
    )


def _without_third(
    series: Sequence[np.ndarray], times: Sequence[np.ndarray], k: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Every clock's series and times but for the k-th third of its frames."""
    kept = [np.delete(np.arange(len(t)), np.array_split(np.arange(len(t)), _THIRDS)[k]) for t in times]
    return (
        [y[rows] for y, rows in zip(series, kept, strict=True)],
        [t[rows] for t, rows in zip(times, kept, strict=True)],
    )


def _strong(y: np.ndarray, most: int = 64) -> np.ndarray:
    """The series with the most power, which decide."""
    return y[:, np.argsort((y**2).sum(0))[::-1][:most]]


def _deviation(
    series: Sequence[np.ndarray], times: Sequence[np.ndarray], noise: Sequence[np.ndarray], hz: np.ndarray
) -> np.ndarray:
    """Cramér-Rao bound of each frequency: σ_f² = 3 / (π² D² Σ SNR), D the duration, Σ over series of a² F / 2σ²."""
    out = []
    for f in hz:
        information = 0.0
        for y, t, n in zip(series, times, noise, strict=True):
            used = n > 0
            x = sinusoids(t, np.array([f])).T
            amplitude2 = (np.linalg.lstsq(x, y[:, used], rcond=None)[0] ** 2).sum(0)
            snr = len(t) * amplitude2 / (2 * n[used])
            information += float(np.maximum(snr - 1, 0).sum()) * float(np.ptp(t)) ** 2
        out.append(np.sqrt(3 / (np.pi**2 * max(information, 1e-12))))
    return np.array(out)


def sinusoids(times_s: np.ndarray, freqs_hz: np.ndarray) -> np.ndarray:
    """[2K, F]: cos 2πf_k t and −sin 2πf_k t by turns: Re[m exp(i 2πf t)] = Re m · row 2k + Im m · row 2k + 1."""
    angles = 2 * np.pi * np.asarray(freqs_hz)[:, None] * times_s
    return np.stack([np.cos(angles), -np.sin(angles)], 1).reshape(-1, len(times_s))
