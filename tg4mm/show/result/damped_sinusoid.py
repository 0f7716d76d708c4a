"""How exactly a frequency is known, and whether it rings down, from the motion's own series over time.

A damped sinusoid A exp(−δ t) cos(2π f t + φ) is fitted beside the other frequencies, a constant and a trend, by
variable projection (Golub & Pereyra 1973). The deviations of f and δ are those of nonlinear least squares, σ² (JᵀJ)⁻¹,
which for white noise are the Cramér-Rao bounds, σ_f = √6 σ / (π a √T D) for T samples of a sinusoid of amplitude a over
D seconds (Kay 1993). σ is what the fit leaves, and no less than the noise that two halves of the data say. What is left
is seldom white, so the scatter of the fit without each third of the record (the jackknife) is added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

FEWEST = 8  # samples from which there is anything to fit
_FURTHEST = 0.75  # bins that a frequency may be moved by
_STEEPEST = 10.0  # largest δ D: where a fit ends there, the decay is not told
_SURE = 3.0  # deviations by which damping must differ from none
_LEAST_DECAY = 0.1  # of δ D: a decay by a tenth over the record
_BLOCKS = 3


@dataclass(frozen=True)
class DampedSinusoid:
    """A frequency's standard deviation, and the damping ratio δ / (2π f) where the record shows one."""

    deviation_hz: float
    damping: float | None
    damping_deviation: float | None
    why_no_damping: str = ""


def damped_sinusoid_of(
    series: np.ndarray, fps: float, hz: float, others: np.ndarray, noise: float
) -> DampedSinusoid:
    """Of the frequency `hz` in a series [T], which holds the frequencies `others` too.

    noise: standard deviation of the series' noise over the rms of the vibration, at least. A record too short to fit
    knows the frequency to a bin, uniformly distributed.
    """
    n = len(series)
    duration, t = n / fps, (np.arange(n) - (n - 1) / 2) / fps
    coarse = DampedSinusoid(1 / (duration * np.sqrt(12)), None, None, "the record is too short")
    beside = _beside(t, others)
    if n < FEWEST or n < beside.shape[1] + 5:
        return coarse
    found, jacobian, left = _fitted(series, t, hz, beside, duration)
    model = float(np.sqrt(max(((series**2).sum() - (left**2).sum()) / n, 0.0)))
    sigma = max(float(np.sqrt((left**2).sum() / (n - beside.shape[1] - 4))), noise * model)
    try:
        bound = sigma * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    except np.linalg.LinAlgError:
        return coarse
    spread = _jackknife(series, t, hz, beside, duration)
    # The modes' own frequency is what is shown and played; where the fit lands elsewhere, it is as uncertain as that.
    deviation = np.hypot(np.hypot(bound[0], spread[0]), found[0] - hz)
    return DampedSinusoid(
        float(deviation), *_damping(found[1], float(np.hypot(bound[1], spread[1])), hz, duration)
    )


def _damping(
    decay: float, deviation: float, hz: float, duration: float
) -> tuple[float | None, float | None, str]:
    if decay * duration > 0.99 * _STEEPEST:
        return None, None, "it dies out too early in the record"
    if decay > max(_SURE * deviation, _LEAST_DECAY / duration):
        return decay / (2 * np.pi * hz), deviation / (2 * np.pi * hz), ""
    if -decay > max(_SURE * deviation, _LEAST_DECAY / duration):
        return None, None, "the vibration grows during the record"
    return None, None, "the vibration stays as strong as it is during the record"


def _beside(t: np.ndarray, others: np.ndarray) -> np.ndarray:
    """[T, P]: a constant, a trend, and sinusoids of the other frequencies."""
    angles = 2 * np.pi * t[:, None] * np.asarray(others, float)
    trend = t / max(np.abs(t).max(), 1e-12)
    return np.hstack([np.ones((len(t), 1)), trend[:, None], np.cos(angles), np.sin(angles)])


def _fitted(
    y: np.ndarray, t: np.ndarray, hz: float, beside: np.ndarray, duration: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(frequency, decay), the residual's Jacobian [T, 2] by them, and the residual [T]."""
    scale = float(np.sqrt((y**2).sum())) or 1.0

    def residual(x: np.ndarray) -> np.ndarray:
        wave = np.exp((-x[1] / duration + 2j * np.pi * (hz + x[0] / duration)) * t)
        columns = np.column_stack([beside, wave.real, wave.imag])
        return (y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) / scale

    edge = np.array([_FURTHEST, _STEEPEST])
    best = least_squares(residual, np.zeros(2), bounds=(-edge, edge), xtol=1e-10, ftol=1e-12)
    by_own_units = scale * duration * best.jac
    return np.array([hz + best.x[0] / duration, best.x[1] / duration]), by_own_units, scale * best.fun


def _jackknife(y: np.ndarray, t: np.ndarray, hz: float, beside: np.ndarray, duration: float) -> np.ndarray:
    """[2] standard errors of frequency and decay, from the fits without each third of the record."""
    if len(y) < _BLOCKS * (beside.shape[1] + 4) / (_BLOCKS - 1):
        return np.zeros(2)
    each = []
    for rows in np.array_split(np.arange(len(y)), _BLOCKS):
        kept = np.setdiff1d(np.arange(len(y)), rows)
        each.append(_fitted(y[kept], t[kept], hz, beside[kept], duration)[0])
    spread = np.std(np.array(each), axis=0, ddof=1)
    return np.asarray(spread * (_BLOCKS - 1) / np.sqrt(_BLOCKS))
