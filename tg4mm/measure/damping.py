"""Damping of a vibration that rings down, by the logarithmic decrement: a sinusoid with an exponential envelope.

u(t) = Re[m exp((i2πf − λ) t)] is fitted in the direction of the peak's orbit, f and λ by Gauss-Newton, m projected out;
the logarithmic decrement is λ / f, the damping ratio ζ = λ / (2πf). All samples enter, so that no maxima need be found.
Half-power width would do for records of many decay times; of a shorter one it is the record's own width.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from tg4mm.measure.orbit import orbit_of
from tg4mm.measure.series import Series
from tg4mm.measure.spectrum import Peak, tones

_TOLD = 3.0  # deviations that a decay must stand out of
_LEAST_DECAY = 0.15  # of the amplitude, over the record


@dataclass(frozen=True)
class Damping:
    """Of one peak."""

    ratio: float  # ζ; the logarithmic decrement is 2πζ
    deviation: float
    decay_per_s: float  # λ
    method: str = "logarithmic decrement, exponential envelope fitted"


def damping_of(series: Series, peaks: Sequence[Peak], k: int) -> Damping | None:
    """Of peak k; None where the decay does not stand out of its deviation by three times, or is under 15 %."""
    peak = peaks[k]
    direction = orbit_of(peak).direction
    others = [p.frequency_hz for j, p in enumerate(peaks) if j != k]
    times = series.times_s - series.times_s[0]
    duration = float(np.ptp(times))
    values = series.displacement @ direction
    sigma = np.where(series.is_told, series.noise, 0) @ np.abs(direction)
    plain = tones(np.array(others), times) if others else np.ones((len(times), 1))

    def left(p: np.ndarray) -> np.ndarray:
        envelope = np.exp(-p[1] * (times - duration / 2) / duration)
        angle = 2 * np.pi * p[0] * times
        design = np.concatenate([plain, (envelope * [np.cos(angle), np.sin(angle)]).T], 1)
        return np.asarray(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])

    start = np.array([peak.frequency_hz, 0.1])
    near = 0.5 / duration
    found = least_squares(
        left, start, bounds=([start[0] - near, -8], [start[0] + near, 40]), x_scale=[near, 1.0]
    )
    rest = float((found.fun**2).sum()) / max(len(times) - plain.shape[1] - 4, 1)
    noise = max(float((sigma**2).mean()), rest)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * noise
    decay, deviation = float(found.x[1]), float(np.sqrt(covariance[1, 1]))
    if decay < _TOLD * deviation or 1 - np.exp(-decay) < _LEAST_DECAY:
        return None
    omega = 2 * np.pi * float(found.x[0]) * duration
    return Damping(decay / omega, deviation / omega, decay / duration)
