"""Damping of a vibration, by the logarithmic decrement (ring-down) or the half-power bandwidth (driven by noise).

A ring-down is a line with an exponential envelope (`core.lines`): Re[m exp((i2πf − λ) t)]; the logarithmic decrement is
λ / f. All samples enter, so that no maxima need be found.

A randomly driven structure (wind, traffic) has a peak of finite width: near resonance an oscillator's power spectrum is
S(ν) = S₀ / (1 + (ν − f)² / (ζ f)²), half as high at f (1 ± ζ) [Bendat & Piersol 2010, ch. 6]. Its form with a Hann
window is fitted to the logarithm of Welch's spectrum: the transform of the oscillator's autocorrelation
exp(−2π ζ f |τ|) cos 2πfτ times the window's. Stated where the peak is at least half as wide as the window's.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import get_window, welch

from tg4mm.capture.codec.loss import Loss
from tg4mm.core.lines import FEWEST, Line, fit_lines
from tg4mm.show.measure.series import Series
from tg4mm.show.measure.spectrum import Peak, orbit_of

_SEGMENTS = 7, 15, 31, 63  # half-overlapping windows in the record
_SHORTEST, _CYCLES = 32, 8.0  # of a window: samples, periods
_BINS = 8  # to which a peak is fitted, at least
_WINDOW = 1.44  # full width at half power of Hann's window, over 1 / length
_RESOLVED = 0.5  # times the window's width: a narrower peak is not resolved
_CORRELATED = 1.9 * 1.2  # neighbouring bins of Hann's window, half-overlapping windows [Welch 1967]
HALF_POWER = "half-power bandwidth"


@dataclass(frozen=True)
class Damping:
    """The damping of one peak."""

    ratio: float  # ζ; the logarithmic decrement is 2πζ
    deviation: float
    decay_per_s: float  # λ
    method: str = "logarithmic decrement, exponential envelope fitted"


def damping_of(series: Series, peak: Peak) -> Damping | None:
    """Return the damping of a peak of this series by its decay, else by its width, or None if neither shows it."""
    line = peak.line or _line_of(series, peak.frequency_hz)
    if line is not None and line.damping is not None and line.damping_deviation is not None:
        return Damping(line.damping, line.damping_deviation, line.decay_per_s)
    return half_power(series.times_s, series.displacement @ orbit_of(peak).direction, peak.frequency_hz)


def with_loss(found: Damping | None, loss: Loss) -> Damping | None:
    """Take from the damping what compression adds, by the blind test with a tone that decays alike.

    None where most of the amplitude is known to be lost, or made by the codec: what is left may do anything.
    """
    if loss.is_lost:
        return None
    if found is None or loss.faster is None:
        return found
    per_decay = found.ratio / found.decay_per_s
    decay = max(found.decay_per_s - loss.faster, 0.0)
    deviation = float(np.hypot(found.deviation, per_decay * loss.faster_deviation))
    return replace(found, ratio=per_decay * decay, deviation=deviation, decay_per_s=decay)


def _line_of(series: Series, hz: float) -> Line | None:
    """Fit the line at a frequency that was found in other records too."""
    resolved = series.is_resolved
    values = series.displacement[:, resolved]
    if len(series.times_s) < FEWEST or not values.any():
        return None
    return fit_lines(values, series.times_s, [hz], series.noise[0, resolved]).lines[0]


def half_power(times_s: np.ndarray, values: np.ndarray, frequency_hz: float) -> Damping | None:
    """Return the damping ratio of a peak at `frequency_hz` of values [T] at even times, by its half-power bandwidth.

    None where the peak is less than half as wide as the window's, or its deviation above a third of its width.
    """
    step = float(np.median(np.diff(times_s)))
    for count in _SEGMENTS:  # the longest windows that show it: short ones widen the peak
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
    return Damping(half / centre, deviation / centre, 2 * np.pi * half, HALF_POWER)
