"""Spectra of many series at once and their noise floors; what nuisance leaves of a series, and its lines."""

import numpy as np
from scipy import ndimage

from tg4mm.core.lines import find_lines

PAD = 2  # bins a resolution cell
LOG2 = float(np.log(2))  # median of |noise|² over its mean, for a complex Gaussian
_MEDIAN_SCATTER = 2.08  # variance of log(median of n independent exponentials) times n: 1 / log(2)²
_LEAST_SHAPE = 0.2  # of the common shape: deeper notches come from what was subtracted
_ALIKE = 20  # columns from which a common shape is estimated
_UNEVEN = 0.01  # of a step
_CHANCE = 1e-3  # of one false line in a series that is no shift


def step(times_s: np.ndarray) -> float:
    """The median time between pictures, seconds."""
    return float(np.median(np.diff(times_s)))


def spectrum(series: np.ndarray, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [K] in Hz and complex amplitudes [K, ...] of series [F, ...]; a cosine of amplitude a has |a|.

    Uneven times: by direct summation.
    """
    n, dt = len(times_s), step(times_s)
    if np.abs(np.diff(times_s) - dt).max() < _UNEVEN * dt:
        return np.fft.rfftfreq(PAD * n, dt), np.fft.rfft(series, PAD * n, 0) * (2 / n)
    hz = np.arange(PAD * n // 2 + 1) / (PAD * n * dt)
    return hz, np.tensordot(np.exp(-2j * np.pi * np.outer(hz, times_s)), series, 1) * (2 / n)


def noise_floor(power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean noise power [K, M] of each column of power [K, M] at each frequency, and its degrees of freedom [K].

    A column's floor is a shape common to all columns times the column's level in four overlapping windows. A level is
    the median in its window, shrunk towards that of all columns as far as these are alike (empirical Bayes): a narrow
    window at low frequencies has few bins. Medians are robust to lines.
    """
    count = len(power)
    typical = np.median(power, 0) + 1e-30
    shape = np.median(power / typical, 1) if power.shape[1] > _ALIKE else np.ones(count)
    shape = np.maximum(ndimage.median_filter(shape, 4 * PAD + 1, mode="nearest"), _LEAST_SHAPE)
    flat = power / shape[:, None]
    level = np.median(flat[2 * PAD :], 0) + 1e-30
    of_level = _MEDIAN_SCATTER * PAD / max(count - 2 * PAD, 1)  # its variance, of the logarithm
    windows = _windows(count)
    levels, freedom = [], []
    for first, stop in windows:
        relative = np.log(np.median(flat[first:stop], 0) / level + 1e-30)
        scatter = _MEDIAN_SCATTER * PAD / (stop - first)
        shared, between = 0.0, 9.0
        if len(relative) > 8:
            shared = float(np.median(relative))
            between = max(
                (1.4826 * float(np.median(np.abs(relative - shared)))) ** 2 - scatter - of_level, 0.0
            )
        weight = between / (between + scatter)
        drawn = (1 - weight) * shared + weight * relative
        levels.append(level * np.exp(np.maximum(drawn, relative - scatter**0.5)) / LOG2)
        freedom.append(2 / (weight * scatter + of_level))
    at = np.interp(np.arange(count), [(a + b) / 2 for a, b in windows], np.arange(len(windows)))
    low = np.minimum(at.astype(int), max(len(windows) - 2, 0))
    high, part = np.minimum(low + 1, len(windows) - 1), at - low
    floor = np.stack(levels)
    mixed = floor[low] * (1 - part)[:, None] + floor[high] * part[:, None]
    freedoms = np.array(freedom)
    return mixed * shape[:, None], freedoms[low] * (1 - part) + freedoms[high] * part


def _windows(count: int) -> list[tuple[int, int]]:
    """Overlapping ranges of bins, narrow at low frequencies."""
    wanted = [(2 * PAD, 18 * PAD), (8 * PAD, max(0.5 * count, 36 * PAD)), (0.3 * count, 0.85 * count)]
    ranges = [(int(a), min(int(b), count)) for a, b in [*wanted, (0.5 * count, count)]]
    return [r for r in ranges if r[0] < count - 8 * PAD] or [(min(2 * PAD, count - 1), count)]


def without(series: np.ndarray, nuisance: np.ndarray, seen: np.ndarray | None = None) -> np.ndarray:
    """Series [F, M] less their least-squares fit by nuisance [F, P].

    seen [F, M] bool: samples not seen are left out of the fit and become 0.
    """
    if seen is None or seen.all():
        q = np.linalg.qr(nuisance)[0]
        return np.asarray(series - q @ (q.T @ series))
    out, whole = np.zeros_like(series), seen.all(0)
    if whole.any():
        out[:, whole] = without(series[:, whole], nuisance)
    for m in np.flatnonzero(~whole):
        rows = seen[:, m]
        if rows.sum() > 3 * nuisance.shape[1]:
            fit = np.linalg.lstsq(nuisance[rows], series[rows, m], rcond=None)[0]
            out[rows, m] = series[rows, m] - nuisance[rows] @ fit
    return out


def tones_of(
    series: np.ndarray, times_s: np.ndarray, nuisance: np.ndarray, most: int = 4
) -> list[tuple[float, float, float]]:
    """Frequency, its ± (Hz) and amplitude of the lines of one series [F] beside nuisance [F, P], strongest first."""
    found = find_lines(without(series[:, None], nuisance), times_s, most=most, chance=_CHANCE).lines
    return [(line.hz, line.hz_deviation, float(line.amplitude[0])) for line in found]
