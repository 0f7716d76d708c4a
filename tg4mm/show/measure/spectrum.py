"""Amplitude spectrum of a sensor with its noise floor, and the peaks that stand out of it.

The spectrum is 2 |Σ w_f u_f exp(−i 2πν t_f)| / Σ w_f with Hann's window w, so that a sinusoid has its amplitude, zero
to peak, at its frequency. Noise of standard deviation s_f has there a Rayleigh distribution with the parameter
√(2 Σ w_f² s_f²) / Σ w_f. The floor is the level that noise alone passes anywhere in the whole spectrum, on any of the
three axes, in one record of a hundred; what lies under it is not told from noise.

Peaks are taken one after another, the strongest over its floor first, by a parabola through the logarithms of the
highest sample and its neighbours; the sinusoids found so far are fitted together by least squares, refined by
Gauss-Newton on their frequencies, and taken out before the next is looked for. Amplitudes and phases are those of that
fit, which a window does not widen; their deviations follow from the samples' [Kay 1993, ch. 3].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tg4mm.show.measure.fourier import (
    OVERSAMPLED,
    floor_factor,
    frequency_grid,
    is_told,
    rayleigh,
    sinusoid_columns,
    transformed,
)
from tg4mm.show.measure.harmonics import Harmonic, Sideband, harmonics_of

_MOST = 8  # peaks
_APART = 1.5  # of 1 / duration: nearer than this two peaks are one
_LEAST_CYCLES = 1.5  # of the record: slower is drift
_STEPS = 6  # of Gauss-Newton
_EACH, _FREE = 3, 4  # samples for each peak, and beside them
FEWEST = _EACH + _FREE  # samples from which there can be a peak
_LEAST = 0.02  # of the strongest peak: harmonics of what is not linear, side lobes that noise left


@dataclass(frozen=True)
class Peak:
    """A sinusoid, u(t) = Re[phasor exp(i 2π f t)] with t in seconds of the clock."""

    frequency_hz: float
    frequency_deviation_hz: float
    phasor: np.ndarray  # [3] complex, scene units, along the series' axes
    deviation: np.ndarray  # [3] standard deviation of the amplitudes, scene units; inf where not observed
    floor: np.ndarray  # [3] of the spectrum at this frequency
    harmonic: Harmonic | None = None  # a stronger peak that this may be a harmonic of
    sideband: Sideband | None = None  # a stronger peak of which a video codec may have made this

    @property
    def amplitude(self) -> np.ndarray:
        """[3] zero to peak, scene units."""
        return np.abs(self.phasor)

    @property
    def is_told(self) -> np.ndarray:
        """[3] bool: axes that are seen, and not ten times less sure than the best one, as one camera's sight is."""
        return is_told(self.floor)

    @property
    def is_above(self) -> np.ndarray:
        """[3] bool: whether the amplitude stands out of the floor, and of twice its own deviation."""
        return np.asarray((self.amplitude > self.floor) & (self.amplitude > 2 * self.deviation))

    @property
    def phase_deviation(self) -> np.ndarray:
        """[3] radians, π at most."""
        return np.minimum(self.deviation / np.maximum(self.amplitude, 1e-300), np.pi)


@dataclass(frozen=True)
class Spectrum:
    """Of F frequencies from 0 to half the frame rate, eight to each 1 / duration."""

    freqs_hz: np.ndarray  # [F]
    amplitude: np.ndarray  # [F, 3] zero to peak, scene units
    floor: np.ndarray  # [F, 3] inf where not observed
    peaks: tuple[Peak, ...]  # by falling amplitude over floor
    window: str = "hann, amplitude-corrected"


def spectrum_of(
    times_s: np.ndarray, values: np.ndarray, deviation: np.ndarray, model_share: np.ndarray | None = None
) -> Spectrum:
    """Of values [T, 3] with noise of standard deviations [T, 3] at times [T], which need not be even.

    model_share [3]: standard deviation of errors that grow with the motion, over its length; of the peaks' deviations.
    """
    grid = frequency_grid(times_s)
    is_seen = np.isfinite(deviation).all(0)
    values = np.where(is_seen, values, 0.0)
    finite = np.where(np.isfinite(deviation), deviation, 0.0)
    level = np.where(is_seen, rayleigh(times_s, finite) * floor_factor(len(times_s)), np.inf)
    floor = np.broadcast_to(level, (len(grid), 3))
    amplitude = np.abs(transformed(grid, times_s, values))
    hz = _peaks(grid, times_s, values, level)
    peaks = ordered(_fitted(hz, times_s, values, finite, level, model_share))
    return Spectrum(grid, amplitude, floor, with_harmonics(peaks, times_s))


def ordered(peaks: Sequence[Peak]) -> tuple[Peak, ...]:
    """By falling amplitude over the floor."""
    return tuple(sorted(peaks, key=strength_of, reverse=True))


def with_harmonics(peaks: Sequence[Peak], times_s: np.ndarray) -> tuple[Peak, ...]:
    """The peaks of a record at these times; those that may be a harmonic of a stronger one say so."""
    step = float(np.median(np.diff(times_s)))
    size = [size_of(p) for p in peaks]
    hz, deviation = [p.frequency_hz for p in peaks], [p.frequency_deviation_hz for p in peaks]
    found = harmonics_of(hz, deviation, size, 1 / step, 1 / (step * len(times_s)))
    return tuple(replace(p, harmonic=h) for p, h in zip(peaks, found, strict=True))


def size_of(peak: Peak) -> float:
    """Amplitude along the axes that are told, scene units."""
    return float(np.linalg.norm(peak.amplitude[peak.is_told]))


def strength_of(peak: Peak) -> float:
    """Amplitude over floor, of the axis where that is largest."""
    scale = np.where(np.isfinite(peak.floor), np.maximum(peak.floor, 1e-300), np.inf)
    return float((peak.amplitude / scale).max())


def _peaks(grid: np.ndarray, times_s: np.ndarray, values: np.ndarray, level: np.ndarray) -> np.ndarray:
    """[K] Hz."""
    resolution = grid[1] * OVERSAMPLED
    usable = (grid >= _LEAST_CYCLES * resolution) & (grid <= grid[-1] - resolution / 2)
    # axes by their own noise: a single camera's sight must not decide a frequency
    least = max(1e-9 * float(np.abs(values).max()), 1e-300)  # rounding, where there is no noise at all
    scale = np.where(np.isfinite(level), np.maximum(level, least), np.inf)
    values = values / scale
    hz, left, strongest = np.zeros(0), values, 0.0
    while len(hz) < min(_MOST, (len(times_s) - _FREE) // _EACH):
        amplitude = np.abs(transformed(grid, times_s, left))
        height = np.where(usable, amplitude.max(1), 0)
        for other in hz:
            height[np.abs(grid - other) < _APART * resolution] = 0
        at = int(height.argmax())
        size = float(np.linalg.norm(amplitude[at]))
        strongest = max(strongest, size)
        if height[at] <= 1 or size < _LEAST * strongest:
            break
        axis = int(amplitude[at].argmax())
        hz = np.append(hz, _parabola(grid, amplitude[:, axis], at))
        hz = _refined(hz, times_s, values)
        design = sinusoid_columns(hz, times_s)
        left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return hz


def _parabola(grid: np.ndarray, amplitude: np.ndarray, at: int) -> float:
    """The frequency of the vertex of a parabola through three logarithms."""
    if not 0 < at < len(grid) - 1:
        return float(grid[at])
    a, b, c = np.log(np.maximum(amplitude[at - 1 : at + 2], 1e-300))
    curvature = a - 2 * b + c
    shift = 0.5 * (a - c) / curvature if curvature < 0 else 0.0
    return float(grid[at] + np.clip(shift, -1, 1) * grid[1])


def _refined(hz: np.ndarray, times_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Frequencies by Gauss-Newton with the phasors projected out (variable projection, Kaufman's form)."""
    most = 0.5 / (np.ptp(times_s) + 1e-12)
    start, middle = hz.copy(), times_s.mean()
    for _ in range(_STEPS):
        design = sinusoid_columns(hz, times_s)
        answer = np.linalg.lstsq(design, values, rcond=None)[0]
        left = values - design @ answer
        n = len(hz)
        slopes = []
        for k in range(n):
            a, b = answer[1 + k], answer[1 + n + k]
            angle = 2 * np.pi * hz[k] * times_s[:, None]
            slope = 2 * np.pi * (times_s - middle)[:, None] * (-a * np.sin(angle) - b * np.cos(angle))
            slopes.append(slope - design @ np.linalg.lstsq(design, slope, rcond=None)[0])
        jacobian = np.stack([s.ravel() for s in slopes], 1)
        step = np.linalg.lstsq(jacobian, left.ravel(), rcond=None)[0]
        hz = np.clip(hz + step, start - most, start + most)
        if np.abs(step).max() < 1e-6 * most:
            break
    return hz


def _fitted(
    hz: np.ndarray,
    times_s: np.ndarray,
    values: np.ndarray,
    deviation: np.ndarray,
    level: np.ndarray,
    model_share: np.ndarray | None,
) -> tuple[Peak, ...]:
    if not len(hz):
        return ()
    design, n = sinusoid_columns(hz, times_s), len(hz)
    inverse = np.linalg.pinv(design.T @ design)
    answer = inverse @ design.T @ values
    gain = (inverse @ design.T) ** 2  # of samples' variances
    variance = gain @ deviation**2
    mean_square = (deviation**2).mean(0)
    peaks = []
    for k in range(n):
        phasor = answer[1 + k] + 1j * answer[1 + n + k]
        both = np.sqrt((variance[1 + k] + variance[1 + n + k]) / 2)
        if model_share is not None:
            both = np.hypot(both, model_share * np.linalg.norm(phasor[is_told(level)]))
        both = np.where(np.isfinite(level), both, np.inf)
        good = mean_square > 0
        snr = float((np.abs(phasor[good]) ** 2 / mean_square[good]).sum()) * len(times_s) / 2
        span = np.ptp(times_s) * len(times_s) / (len(times_s) - 1)
        error = float(np.sqrt(3 / (np.pi**2 * snr)) / span) if snr > 0 else 0.0
        peaks.append(Peak(float(hz[k]), error, phasor, both, level))
    return tuple(peaks)
