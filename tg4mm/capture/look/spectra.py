"""Spectra of many series at once, their noise floors, and the lines of a single series."""

import numpy as np
from scipy import ndimage, optimize, stats

PAD = 2  # bins a resolution cell
LOG2 = float(np.log(2))  # median of |noise|² over its mean, for a complex Gaussian
_MEDIAN_SCATTER = 2.08  # variance of log(median of n independent exponentials) times n: 1 / log(2)²
_LEAST_SHAPE = 0.2  # of the common shape: deeper notches come from what was subtracted
_ALIKE = 20  # columns from which a common shape is told
_UNEVEN = 0.01  # of a step


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

    A column's floor is a shape that all columns share times a level of its own in four overlapping windows. A level is
    the median in its window, drawn towards that of all columns as far as these are alike (empirical Bayes): a narrow
    window at low frequencies knows little by itself. Medians pass by lines.
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
        own = _MEDIAN_SCATTER * PAD / (stop - first)
        shared, between = 0.0, 9.0
        if len(relative) > 8:
            shared = float(np.median(relative))
            between = max((1.4826 * float(np.median(np.abs(relative - shared)))) ** 2 - own - of_level, 0.0)
        weight = between / (between + own)
        drawn = (1 - weight) * shared + weight * relative
        levels.append(level * np.exp(np.maximum(drawn, relative - own**0.5)) / LOG2)
        freedom.append(2 / (weight * own + of_level))
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


def tone(times_s: np.ndarray, hz: float) -> np.ndarray:
    """[F, 2]: cosine and sine."""
    angle = 2 * np.pi * hz * times_s
    return np.stack([np.cos(angle), np.sin(angle)], 1)


def explained(series: np.ndarray, columns: np.ndarray) -> float:
    """The energy of series [F] that two columns [F, 2] explain."""
    products, by_series = columns.T @ columns, columns.T @ series
    a, b, c = products[0, 0], products[0, 1], products[1, 1]
    determinant = a * c - b * b
    if determinant <= 1e-9 * a * c:
        return 0.0
    p, q = by_series
    return float((c * p * p - 2 * b * p * q + a * q * q) / determinant)


def refined(series: np.ndarray, times_s: np.ndarray, hz: float) -> float:
    """The frequency of the largest tone of series [F] within .6 / duration of hz, inside (0, half the rate)."""
    duration = times_s[-1] - times_s[0]
    half, top = 0.6 / duration, 0.5 / step(times_s) - 0.3 / duration
    hz = min(hz, top - 0.01 / duration)
    bounds = (max(hz - half, 0.2 / duration), min(hz + half, top))
    found = optimize.minimize_scalar(
        lambda f: -explained(series, tone(times_s, f)),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-5 * half},
    )
    return float(found.x)


def tones_of(
    series: np.ndarray, times_s: np.ndarray, nuisance: np.ndarray, most: int = 4, chance: float = 1e-3
) -> list[tuple[float, float, float]]:
    """Frequency, its ± (Hz) and amplitude of the lines of one series [F]: F-tests against its local floor.

    chance: of one false line in the series.
    """
    found: list[tuple[float, float, float]] = []
    left = without(series[:, None], nuisance)
    dt = step(times_s)
    duration = times_s[-1] - times_s[0] + dt
    for _ in range(most):
        hz, amplitudes = spectrum(left, times_s)
        power = np.abs(amplitudes) ** 2
        floor, freedom = noise_floor(power)
        ratio = (power / floor)[:, 0]
        ratio[(hz < 2 / duration) | (hz > 0.5 / dt - 0.25 / duration)] = 0
        k = int(np.argmax(ratio))
        if stats.f.sf(ratio[k], 2, freedom[k]) * len(hz) > chance:
            break
        at = refined(left[:, 0], times_s, float(hz[k]))
        columns = tone(times_s, at)
        fit = np.linalg.lstsq(columns, left[:, 0], rcond=None)[0]
        amplitude = float(np.hypot(*fit))
        found.append((at, float(np.sqrt(3 * floor[k, 0]) / np.pi / (amplitude * duration)), amplitude))
        left = left - (columns @ fit)[:, None]
    return found
