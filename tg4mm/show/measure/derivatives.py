"""Velocity and acceleration: lines are differentiated exactly, the residual by finite differences.

Differences alone would lose much of a fast vibration, 17 % of the velocity at six samples a period. A sample's noise n
and a line's error δ give the error D n + (d/dt − D) δ with the differences D; errors proportional to the motion are
proportional to its derivative, too. The deviations do not cover motion outside of lines above a quarter of the rate.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.show.measure.spectrum import Peak


@dataclass(frozen=True)
class Derivatives:
    """The derivatives of a displacement [T, A]."""

    velocity: np.ndarray  # [T, A] scene units / s
    acceleration: np.ndarray  # [T, A] scene units / s²


def derivatives_of(times_s: np.ndarray, values: np.ndarray, peaks: Sequence[Peak]) -> Derivatives:
    """Differentiate values [T, A] at times [T] with known `peaks`."""
    velocity, acceleration, left = np.zeros_like(values), np.zeros_like(values), values.copy()
    for peak in peaks:
        omega = 2j * np.pi * peak.frequency_hz - (0.0 if peak.line is None else peak.line.decay_per_s)
        phasor = np.where(np.isfinite(peak.deviation), peak.phasor, 0)
        turning = peak.envelope(times_s) * np.exp(2j * np.pi * peak.frequency_hz * times_s)
        left -= (turning[:, None] * phasor).real
        velocity += (omega * turning[:, None] * phasor).real
        acceleration += (omega**2 * turning[:, None] * phasor).real
    velocity += np.gradient(left, times_s, axis=0)
    acceleration += _second_difference(left, times_s)
    return Derivatives(velocity, acceleration)


def deviations_of(
    found: Derivatives, times_s: np.ndarray, noise: np.ndarray, share: np.ndarray, peaks: Sequence[Peak]
) -> Derivatives:
    """Return standard deviations of `found` for samples with noise [T, A] and errors of a `share` [A] of the motion."""
    step = float(np.median(np.diff(times_s)))
    variances = [_difference_variance(noise**2, times_s), _second_variance(noise**2, times_s)]
    for peak in peaks:
        omega, size = 2 * np.pi * peak.frequency_hz, peak.envelope(times_s)[:, None] * peak.deviation
        missed = omega - np.sin(omega * step) / step, omega**2 - (2 * np.sin(omega * step / 2) / step) ** 2
        for order in (0, 1):
            variances[order] = variances[order] + (missed[order] * size) ** 2
    out = []
    for variance, values in zip(variances, (found.velocity, found.acceleration), strict=True):
        length = np.linalg.norm(np.where(np.isfinite(variance), values, 0), axis=1)
        out.append(np.sqrt(variance + (share * length[:, None]) ** 2))
    return Derivatives(*out)


def _difference_variance(variance: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Return the variance [T, A] of `np.gradient` of independent samples."""
    out = np.empty_like(variance)
    before, after = np.diff(times_s)[:-1, None], np.diff(times_s)[1:, None]
    total, old, mid, new = before + after, variance[:-2], variance[1:-1], variance[2:]
    out[1:-1] = (before / (after * total)) ** 2 * new + (after / (before * total)) ** 2 * old
    out[1:-1] += np.where(before == after, 0.0, ((after - before) / (before * after)) ** 2 * mid)
    out[0] = (variance[0] + variance[1]) / (times_s[1] - times_s[0]) ** 2
    out[-1] = (variance[-1] + variance[-2]) / (times_s[-1] - times_s[-2]) ** 2
    return out


def _second_variance(variance: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    out = np.full_like(variance, np.inf)
    if len(variance) < 3:
        return out
    before, after = np.diff(times_s)[:-1, None], np.diff(times_s)[1:, None]
    total = before + after
    out[1:-1] = 4 * (
        variance[2:] / (after * total) ** 2
        + variance[1:-1] / (before * after) ** 2
        + variance[:-2] / (before * total) ** 2
    )
    out[0], out[-1] = out[1], out[-2]
    return out


def _second_difference(values: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    out = np.zeros_like(values)
    if len(values) < 3:
        return out
    before, after = np.diff(times_s)[:-1, None], np.diff(times_s)[1:, None]
    out[1:-1] = (
        2 * ((values[2:] - values[1:-1]) / after - (values[1:-1] - values[:-2]) / before) / (before + after)
    )
    out[0], out[-1] = out[1], out[-2]
    return out
