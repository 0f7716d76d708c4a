"""Damping of a vibration: by the logarithmic decrement where it rings down, by the half-power bandwidth where noise
drives it.

Ringing down is a sinusoid with an exponential envelope:

u(t) = Re[m exp((i2πf − λ) t)] is fitted in the direction of the peak's orbit, f and λ by Gauss-Newton, m projected out;
the logarithmic decrement is λ / f, the damping ratio ζ = λ / (2πf). All samples enter, so that no maxima need be found.

What is driven at random (wind, traffic) has a peak of finite width: near resonance an oscillator's power spectrum is
S(ν) = S₀ / (1 + (ν − f)² / (ζ f)²), half as high at f (1 ± ζ) [Bendat & Piersol 2010, ch. 6]. What a Hann window makes
of that is fitted to the logarithm of Welch's spectrum: the oscillator's autocorrelation exp(−2π ζ f |τ|) cos 2πfτ times
the window's. Given where the peak is at least half as wide as the window's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import get_window, welch

from tg4mm.show.measure.fourier import sinusoid_columns
from tg4mm.show.measure.orbit import orbit_of
from tg4mm.show.measure.series import Series
from tg4mm.show.measure.spectrum import Peak

_TOLD = 3.0  # deviations that a decay must stand out of
_LEAST_DECAY = 0.15  # of the amplitude, over the record
_STEEPEST = 40.0  # decay over the record, at most
_SEGMENTS = 7, 15, 31, 63  # half-overlapping windows in the record
_SHORTEST, _CYCLES = 32, 8.0  # of a window: samples, periods
_BINS = 8  # that a peak is fitted to, at least
_WINDOW = 1.44  # full width at half power of Hann's window, over 1 / length
_RESOLVED = 0.5  # times the window's own width that a peak must be wide
_CORRELATED = 1.9 * 1.2  # neighbouring bins of Hann's window, half-overlapping windows [Welch 1967]


@dataclass(frozen=True)
class Damping:
    """Of one peak."""

    ratio: float  # ζ; the logarithmic decrement is 2πζ
    deviation: float
    decay_per_s: float  # λ
    method: str = "logarithmic decrement, exponential envelope fitted"


def damping_of(series: Series, peaks: Sequence[Peak], k: int) -> Damping | None:
    """Of peak k: of what rings down by its decay, else by its width; None where neither can be told.

    A decay must stand out of its deviation by three times, and be 15 % or more.
    """
    peak = peaks[k]
    direction = orbit_of(peak).direction
    others = [p.frequency_hz for j, p in enumerate(peaks) if j != k]
    times = series.times_s - series.times_s[0]
    duration = float(np.ptp(times))
    values = series.displacement @ direction
    sigma = np.where(series.is_told, series.noise, 0) @ np.abs(direction)
    plain = sinusoid_columns(np.array(others), times) if others else np.ones((len(times), 1))

    def left(p: np.ndarray) -> np.ndarray:
        envelope = np.exp(-p[1] * (times - duration / 2) / duration)
        angle = 2 * np.pi * p[0] * times
        design = np.concatenate([plain, (envelope * [np.cos(angle), np.sin(angle)]).T], 1)
        return np.asarray(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])

    start = np.array([peak.frequency_hz, 0.1])
    near = 0.5 / duration
    found = least_squares(
        left, start, bounds=([start[0] - near, -8], [start[0] + near, _STEEPEST]), x_scale=[near, 1.0]
    )
    rest = float((found.fun**2).sum()) / max(len(times) - plain.shape[1] - 4, 1)
    noise = max(float((sigma**2).mean()), rest)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * noise
    decay, deviation = float(found.x[1]), float(np.sqrt(covariance[1, 1]))
    if decay > 0.99 * _STEEPEST:  # ended by the bound: gone too early in the record
        return None
    if decay < _TOLD * deviation or 1 - np.exp(-decay) < _LEAST_DECAY:
        return half_power(series.times_s, values, peak.frequency_hz)
    omega = 2 * np.pi * float(found.x[0]) * duration
    return Damping(decay / omega, deviation / omega, decay / duration)


def half_power(times_s: np.ndarray, values: np.ndarray, frequency_hz: float) -> Damping | None:
    """Damping ratio of a peak at `frequency_hz` of values [T] at even times, by its half-power bandwidth.

    None where the peak is not half as wide as the window's own, or its deviation is above a third of it.
    """
    step = float(np.median(np.diff(times_s)))
    for count in _SEGMENTS:  # the longest windows that tell it: short ones widen the peak
        length = 2 * len(values) // (count + 1)
        if length < _SHORTEST or length * step * frequency_hz < _CYCLES:
            break
        if (found := _fitted_width(values, step, length, count, frequency_hz)) is not None:
            return found
    return None


def _fitted_width(
    values: np.ndarray, step: float, length: int, count: int, frequency_hz: float
) -> Damping | None:
    hz, power = welch(values, 1 / step, "hann", length, detrend="constant")
    own = _WINDOW / (length * step)  # full width at half power of the window, Hz
    near = np.abs(hz - frequency_hz) < max(0.3 * frequency_hz, 3 * own)
    near &= hz > own
    x, y = hz[near], power[near]
    if len(x) < _BINS or not y.max() > 0:
        return None
    top = float(y.max())

    lags = np.arange(length) * step
    hann = get_window("hann", length)
    window = np.correlate(hann, hann, "full")[length - 1 :]

    def seen(centre: float, half: float) -> np.ndarray:
        kernel = window * np.exp(-2 * np.pi * half * lags) * np.cos(2 * np.pi * centre * lags)
        kernel[0] /= 2
        shape = np.maximum(np.fft.rfft(kernel, 2 * length)[::2].real[: len(hz)], 0)[near]
        return shape / max(shape.max(), 1e-300)

    def left(p: np.ndarray) -> np.ndarray:
        return np.log(np.maximum(p[0] * seen(p[1], p[2]) + p[3], 1e-9)) - np.log(y / top)

    bounds = [0, x[0], own / 50, 0], [10, x[-1], np.ptp(x), 1]
    start = np.clip([1.0, x[y.argmax()], own, 1e-2], np.array(bounds[0]) + 1e-6, np.array(bounds[1]) - 1e-6)
    fit = least_squares(left, start, bounds=bounds, x_scale=[1, own, own, 0.1])
    centre, half = float(fit.x[1]), float(fit.x[2])
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * _CORRELATED / count
    deviation = float(np.sqrt(covariance[2, 2]))
    if 2 * half < _RESOLVED * own or deviation > half / 3:
        return None
    return Damping(half / centre, deviation / centre, 2 * np.pi * half, "half-power bandwidth")
