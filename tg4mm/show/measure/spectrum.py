"""Amplitude spectrum of a sensor with its noise floor, and the peaks that stand out of it.

The spectrum is 2 |Σ w_f u_f exp(−i 2πν t_f)| / Σ w_f with Hann's window w, so that a sinusoid has its amplitude, zero
to peak, at its frequency. Noise of standard deviation s_f has there a Rayleigh distribution with the parameter
√(2 Σ w_f² s_f²) / Σ w_f. The floor is the level that noise alone passes anywhere in the whole spectrum, on any of the
axes, in one record of a hundred; s is what is known of the samples, and where that is more, what is left around a
frequency when the lines are taken out. What lies under the floor is not told from noise.

Peaks are the record's lines (`core.lines`): steady, ringing down, growing, or beginning in the record, each tested.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tg4mm.core.lines import Line, Lines, find_lines
from tg4mm.core.lines.band import Tone, tone_in
from tg4mm.show.measure.fourier import floor_factor, frequency_grid, is_resolved, rayleigh, transformed
from tg4mm.show.measure.harmonics import Harmonic, Sideband, harmonics_of


@dataclass(frozen=True)
class Peak:
    """A line, u(t) = e(t) Re[phasor exp(i 2π f t)] with t in seconds of the clock and the envelope e(t) of `line`."""

    frequency_hz: float
    frequency_deviation_hz: float
    phasor: np.ndarray  # [A] complex, scene units, along the series' axes
    deviation: np.ndarray  # [A] standard deviation of the amplitudes, scene units; inf where not observed
    floor: np.ndarray  # [A] of the spectrum at this frequency
    line: Line | None = None  # along the axes that are seen; None: of clips, steady
    harmonic: Harmonic | None = None  # a stronger peak that this may be a harmonic of
    sideband: Sideband | None = None  # a stronger peak of which a video codec may have made this
    asked: Tone | None = None  # what was asked for by its band and does not stand out; None: it was found
    correlation: np.ndarray | None = None  # [A, A] of the axes' deviations; None: they are independent

    @property
    def amplitude(self) -> np.ndarray:
        """[A] zero to peak, where the envelope is largest, scene units."""
        return np.abs(self.phasor)

    @property
    def is_resolved(self) -> np.ndarray:
        """[A] bool: axes that are seen, and not ten times less sure than the best one, as one camera's sight is."""
        return is_resolved(self.floor)

    @property
    def is_above(self) -> np.ndarray:
        """[A] bool: whether the amplitude stands out of the floor, and of twice its own deviation."""
        return np.asarray((self.amplitude > self.floor) & (self.amplitude > 2 * self.deviation))

    def envelope(self, times_s: np.ndarray) -> np.ndarray:
        """[T], 1 at most."""
        return np.ones(len(times_s)) if self.line is None else self.line.envelope(times_s)

    @property
    def phase_deviation(self) -> np.ndarray:
        """[A] radians, π at most."""
        return np.minimum(self.deviation / np.maximum(self.amplitude, 1e-300), np.pi)


@dataclass(frozen=True)
class Spectrum:
    """The spectrum at F frequencies from 0 to half the frame rate, eight to each 1 / duration."""

    freqs_hz: np.ndarray  # [F]
    amplitude: np.ndarray  # [F, A] zero to peak, scene units
    floor: np.ndarray  # [F, A] inf where not observed
    peaks: tuple[Peak, ...]  # by falling amplitude over floor
    window: str = "hann, amplitude-corrected"

    @property
    def typical_floor(self) -> np.ndarray:
        """[A] median over frequency."""
        return np.median(self.floor, axis=0)


def spectrum_of(
    times_s: np.ndarray,
    values: np.ndarray,
    deviation: np.ndarray,
    model_share: np.ndarray | None = None,
    between: np.ndarray | None = None,
) -> Spectrum:
    """Return the spectrum of values [T, A] with noise of deviations [T, A] at times [T], even or uneven.

    model_share [A]: standard deviation of errors that grow with the motion, over its length; of the peaks' deviations.
    between [T] bool: of pictures that a codec predicts from both sides (`core.lines`).
    """
    grid = frequency_grid(times_s)
    is_seen = np.isfinite(deviation).all(0)
    values = np.where(is_seen, values, 0.0)
    known = np.sqrt((deviation[:, is_seen] ** 2).mean(0))
    found = find_lines(values[:, is_seen], times_s, known, between=between) if is_seen.any() else None
    floor = np.full((len(grid), len(is_seen)), np.inf)
    factor = float(rayleigh(times_s, np.ones((len(times_s), 1)))[0]) * floor_factor(len(times_s))
    floor[:, is_seen] = factor * (known if found is None else np.maximum(known, _levels(found, grid)))
    peaks = [] if found is None else [_peak(line, grid, floor, is_seen, model_share) for line in found.lines]
    amplitude = np.abs(transformed(grid, times_s, values))
    return Spectrum(grid, amplitude, floor, with_harmonics(ordered(peaks), times_s))


def with_band(
    found: Spectrum,
    band: tuple[float, float],
    times_s: np.ndarray,
    values: np.ndarray,
    deviation: np.ndarray,
    model_share: np.ndarray,
) -> Spectrum:
    """With the tone of values [T, A] in a band (Hz) among the peaks, where none of them lies in it.

    Its ± holds what a record of a period or two leaves open (`core/lines/band.py`). Arguments as of `spectrum_of`.
    """
    is_seen = np.isfinite(deviation).all(0)
    if not is_seen.any() or any(band[0] <= p.frequency_hz <= band[1] for p in found.peaks):
        return found
    known = np.sqrt((deviation[:, is_seen] ** 2).mean(0))
    tone = tone_in(values[:, is_seen], times_s, band, known)
    level = found.floor[int(np.abs(found.freqs_hz - tone.hz).argmin())]
    phasor, own = np.zeros(len(is_seen), complex), np.full(len(is_seen), np.inf)
    phasor[is_seen] = tone.phasor
    own[is_seen] = np.hypot(
        tone.amplitude_deviation, model_share[is_seen] * np.linalg.norm(phasor[is_resolved(level)])
    )
    peak = Peak(tone.hz, tone.hz_deviation, phasor, own, level, asked=tone)
    return replace(found, peaks=(*found.peaks, peak))


def _levels(found: Lines, grid: np.ndarray) -> np.ndarray:
    """[F, A] the noise's standard deviation at frequencies [F]."""
    return np.stack([np.interp(grid, found.hz, own) for own in found.noise.T], 1)


def _peak(
    line: Line, grid: np.ndarray, floor: np.ndarray, is_seen: np.ndarray, model_share: np.ndarray | None
) -> Peak:
    """Along all axes: 0, of infinite deviation, where nothing is seen."""
    phasor, deviation = np.zeros(len(is_seen), complex), np.full(len(is_seen), np.inf)
    phasor[is_seen], deviation[is_seen] = line.phasor, line.amplitude_deviation
    level = floor[int(np.abs(grid - line.hz).argmin())]
    if model_share is not None:
        deviation = np.hypot(deviation, model_share * np.linalg.norm(phasor[is_resolved(level)]))
    return Peak(line.hz, line.hz_deviation, phasor, deviation, level, line)


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
    return float(np.linalg.norm(peak.amplitude[peak.is_resolved]))


def strength_of(peak: Peak) -> float:
    """Amplitude over floor, of the axis where that is largest."""
    scale = np.where(np.isfinite(peak.floor), np.maximum(peak.floor, 1e-300), np.inf)
    return float((peak.amplitude / scale).max())
