"""Sinusoids and Hann's window: the spectrum of samples at given times, and the level that their noise has in it."""

import numpy as np

CHANCE = 0.01  # that noise alone passes the floor anywhere
OVERSAMPLED = 8  # frequencies to each 1 / duration
_TOLD = 10.0  # times as uncertain as the best direction: beyond it a direction is not told


def frequency_grid(times_s: np.ndarray) -> np.ndarray:
    """[F] Hz, from 0 to half the frame rate."""
    step = float(np.median(np.diff(times_s)))
    duration = float(np.ptp(times_s)) + step  # frames may be missing
    count = int(duration / (2 * step) * OVERSAMPLED + 1e-9) + 1
    return np.arange(count) / (duration * OVERSAMPLED)


def sinusoid_columns(hz: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """[T, 2K + 1]: a constant, cos 2πf_k t, −sin 2πf_k t."""
    angles = 2 * np.pi * times_s[:, None] * np.asarray(hz)[None]
    return np.concatenate([np.ones((len(times_s), 1)), np.cos(angles), -np.sin(angles)], 1)


def hann(times_s: np.ndarray) -> np.ndarray:
    """[T] Hann's window over the record."""
    step = float(np.median(np.diff(times_s)))
    share = (times_s - times_s[0] + step / 2) / (np.ptp(times_s) + step)
    return np.sin(np.pi * share) ** 2


def transformed(grid: np.ndarray, times_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """[F, 3] complex: 2 Σ w u exp(−i 2πν t) / Σ w of values [T, 3] less their mean; a sinusoid has its phasor there."""
    window = hann(times_s)
    turned = np.exp(-2j * np.pi * grid[:, None] * times_s) * window
    own = values - (window @ values) / window.sum()
    return np.asarray(turned @ own * (2 / window.sum()))


def rayleigh(times_s: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """[3] parameter of the distribution of |`transformed`| of noise with standard deviations [T, 3]."""
    window = hann(times_s)
    return np.asarray(np.sqrt(2 * (window[:, None] ** 2 * deviation**2).sum(0)) / window.sum())


def floor_factor(n_samples: int) -> float:
    """The floor over `rayleigh`: the level that noise alone passes anywhere in one record of a hundred."""
    return float(np.sqrt(-2 * np.log(CHANCE / (3 * max(n_samples // 2, 1)))))


def is_resolved(level: np.ndarray) -> np.ndarray:
    """[3] bool of a floor [3]: seen, and not ten times less sure than the best direction, as one camera's sight is."""
    finite = np.where(np.isfinite(level), level, np.inf)
    return np.isfinite(level) & (finite <= _TOLD * finite.min())
