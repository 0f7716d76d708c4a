"""Amplitude spectrum of a sensor, its noise floor, the peaks above it with their orbits, and their possible origins.

The spectrum is 2 |Σ w_f u_f exp(−i 2πν t_f)| / Σ w_f with Hann's window w, so that a sinusoid has its amplitude, zero
to peak, at its frequency. There, noise of standard deviation s_f has a Rayleigh distribution with the parameter
√(2 Σ w_f² s_f²) / Σ w_f. The floor is the level that noise alone exceeds anywhere in the spectrum, on any axis, in one
record of a hundred; s is the stated deviation of the samples, or the residual around a frequency without the lines if
that is larger. Peaks are the record's lines (`core.lines`), each tested.

A peak may be a harmonic: where pictures do not change in proportion to motion, f makes peaks at 2f and 3f too. It may
also be a sideband from a video codec. Every Pth frame is predicted forward, those between from both sides and more
coarsely, so that a motion of f Hz also appears at k / (P Δt) ± f. H.264 of x264, P = 4: 3.4 Hz at 30 Hz made peaks at
7.5 − 3.4 and 15 − 3.4 Hz, thirty times weaker (docs/measure.md). Where the codec removes most of a small motion, the
rest is up to three times the sideband. Encoders without such a period make lines at these frequencies too.

The orbit is the ellipse that a sensor traces at one frequency, in the directions that the cameras resolve. One camera
hardly resolves its line of sight, and cameras that stand together hardly their common one. Such a direction would fill
the main axis with its noise. So the covariance's eigenvectors are left out from the least certain one on: each that is
within twice its deviation of 0, as long as it is more than twice as uncertain as the others together, or the main axis
does not exceed twice its deviation. `Orbit.hidden` has these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tg4mm.core.lines import CodecChange, Line, Lines, alias, find_lines
from tg4mm.core.lines.band import BandLine, tone_in

CHANCE = 0.01  # that noise alone exceeds the floor anywhere
OVERSAMPLED = 8  # frequencies to each 1 / duration
_UNRESOLVED = 10.0  # times the deviation of the best direction: a direction beyond it is not resolved
_ORDERS = 2, 3, 5, 7  # 5 and 7: of a codec, and of at most 1 / n (`capture/look/marks.py`)
NEAR = 0.5  # of 1 / duration
SURE = 3.0  # deviations
USUAL_PERIOD = 4  # frames, for a video whose frame types show none
WEAKER = 2.5  # times weaker than the vibration that causes it, at least
TWICE = 2.0  # deviations: a smaller amplitude is not significant


def frequency_grid(times_s: np.ndarray) -> np.ndarray:
    """Return frequencies [F] in Hz, from 0 to half the frame rate."""
    step = float(np.median(np.diff(times_s)))
    duration = float(np.ptp(times_s)) + step  # frames may be missing
    count = int(duration / (2 * step) * OVERSAMPLED + 1e-9) + 1
    return np.arange(count) / (duration * OVERSAMPLED)


def sinusoid_columns(hz: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Return the columns [T, 2K + 1]: a constant, cos 2πf_k t, −sin 2πf_k t."""
    angles = 2 * np.pi * times_s[:, None] * np.asarray(hz)[None]
    return np.concatenate([np.ones((len(times_s), 1)), np.cos(angles), -np.sin(angles)], 1)


def hann(times_s: np.ndarray) -> np.ndarray:
    """Return Hann's window [T] over the record."""
    step = float(np.median(np.diff(times_s)))
    share = (times_s - times_s[0] + step / 2) / (np.ptp(times_s) + step)
    return np.sin(np.pi * share) ** 2


def transformed(grid: np.ndarray, times_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return 2 Σ w u exp(−i 2πν t) / Σ w [F, 3], complex, of values [T, 3] less their mean: a sinusoid's phasor."""
    window = hann(times_s)
    turned = np.exp(-2j * np.pi * grid[:, None] * times_s) * window
    centred = values - (window @ values) / window.sum()
    return np.asarray(turned @ centred * (2 / window.sum()))


def rayleigh(times_s: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Return the parameter [3] of the distribution of |`transformed`| for noise with standard deviations [T, 3]."""
    window = hann(times_s)
    return np.asarray(np.sqrt(2 * (window[:, None] ** 2 * deviation**2).sum(0)) / window.sum())


def floor_factor(n_samples: int) -> float:
    """Return the floor over `rayleigh`: the level that noise alone exceeds anywhere in one record of a hundred."""
    return float(np.sqrt(-2 * np.log(CHANCE / (3 * max(n_samples // 2, 1)))))


def is_resolved(level: np.ndarray) -> np.ndarray:
    """Return whether each floor [3] is finite and at most ten times the lowest (one camera's sight is beyond that)."""
    finite = np.where(np.isfinite(level), level, np.inf)
    return np.isfinite(level) & (finite <= _UNRESOLVED * finite.min())


@dataclass(frozen=True)
class Harmonic:
    """`order` times the frequency `of_hz` of a stronger peak."""

    order: int
    of_hz: float

    def __str__(self) -> str:
        return f"may be a harmonic: {self.order} × {self.of_hz:.4g} Hz"


@dataclass(frozen=True)
class Sideband:
    """|`codec_hz` ± `of_hz`|, of a stronger peak's frequency."""

    codec_hz: float
    of_hz: float
    is_sum: bool

    def __str__(self) -> str:
        sign = "+" if self.is_sum else "−"
        return f"may be of the video's compression: {self.codec_hz:.4g} {sign} {self.of_hz:.4g} Hz"


def harmonics_of(
    hz: Sequence[float], deviation: Sequence[float], size: Sequence[float], fps: float, resolution: float
) -> list[Harmonic | None]:
    """Return for each peak the strongest peak of which it may be a harmonic, or None.

    hz and deviation of the frequencies, size: amplitudes; resolution: 1 / duration, Hz. Harmonics above half the frame
    rate are sought at their aliases.
    """

    def of(k: int) -> Harmonic | None:
        for j in sorted(range(len(hz)), key=lambda j: -size[j]):
            for order in (n for n in _ORDERS if size[j] > size[k] * (n if n > 3 else 1)):
                error = SURE * (deviation[k] ** 2 + (order * deviation[j]) ** 2) ** 0.5
                is_sharp = SURE * deviation[j] < resolution  # else too many peaks would be near
                if is_sharp and abs(alias(order * hz[j], fps) - hz[k]) < max(NEAR * resolution, error):
                    return Harmonic(order, hz[j])
        return None

    return [of(k) for k in range(len(hz))]


@dataclass(frozen=True)
class Peak:
    """A line, u(t) = e(t) Re[phasor exp(i 2π f t)] with t in seconds of the clock and the envelope e(t) of `line`."""

    frequency_hz: float
    frequency_deviation_hz: float
    phasor: np.ndarray  # [A] complex, scene units, along the series' axes
    deviation: np.ndarray  # [A] standard deviation of the amplitudes, scene units; inf where not observed
    floor: np.ndarray  # [A] of the spectrum at this frequency
    line: Line | None = None  # along the observed axes; None for clips: steady
    harmonic: Harmonic | None = None  # a stronger peak of which this may be a harmonic
    sideband: Sideband | None = None  # a stronger peak from which a video codec may have made this
    requested: BandLine | None = (
        None  # the tone in a requested band, which is not significant; None: a peak that was found
    )
    correlation: np.ndarray | None = None  # [A, A] of the axes' deviations; None: they are independent

    @property
    def amplitude(self) -> np.ndarray:
        """Return [A] zero to peak, where the envelope is largest, scene units."""
        return np.abs(self.phasor)

    @property
    def is_resolved(self) -> np.ndarray:
        """Return [A] bool: observed axes at most ten times as uncertain as the best, or with significant motion."""
        return is_resolved(self.floor) | self.is_above

    @property
    def is_above(self) -> np.ndarray:
        """Return [A] bool: whether the amplitude exceeds the floor and twice its deviation."""
        return np.asarray((self.amplitude > self.floor) & (self.amplitude > 2 * self.deviation))

    def envelope(self, times_s: np.ndarray) -> np.ndarray:
        """Return the envelope [T], at most 1."""
        return np.ones(len(times_s)) if self.line is None else self.line.envelope(times_s)

    @property
    def phase_deviation(self) -> np.ndarray:
        """Return [A] radians, π at most."""
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
        """Return [A] median over frequency."""
        return np.median(self.floor, axis=0)


def spectrum_of(
    times_s: np.ndarray,
    values: np.ndarray,
    deviation: np.ndarray,
    model_share: np.ndarray | None = None,
    b_frames: np.ndarray | None = None,
    codec: CodecChange | None = None,
) -> Spectrum:
    """Return the spectrum of values [T, A] with noise of deviations [T, A] at times [T], even or uneven.

    model_share [A]: standard deviation of errors that grow with the motion, over its length; part of the peaks'
    deviations. b_frames [T] bool and codec: as for `find_lines`.
    """
    grid = frequency_grid(times_s)
    is_seen = np.isfinite(deviation).all(0)
    values = np.where(is_seen, values, 0.0)
    known = np.sqrt((deviation[:, is_seen] ** 2).mean(0))
    found = None
    if is_seen.any():
        found = find_lines(values[:, is_seen], times_s, known, b_frames=b_frames, codec=codec)
    floor = np.full((len(grid), len(is_seen)), np.inf)
    factor = float(rayleigh(times_s, np.ones((len(times_s), 1)))[0]) * floor_factor(len(times_s))
    floor[:, is_seen] = factor * (known if found is None else np.maximum(known, _levels(found, grid)))
    lines = [] if found is None else found.lines
    peaks = [_peak(n, floor[int(np.abs(grid - n.hz).argmin())], is_seen, model_share) for n in lines]
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
    """Add the tone of values [T, A] in a band (Hz) to the peaks if none of them lies in it.

    Its ± includes the uncertainty of a record of one or two periods (`core/lines/band.py`). Arguments: `spectrum_of`.
    """
    is_seen = np.isfinite(deviation).all(0)
    if not is_seen.any() or any(band[0] <= p.frequency_hz <= band[1] for p in found.peaks):
        return found
    known = np.sqrt((deviation[:, is_seen] ** 2).mean(0))
    tone = tone_in(values[:, is_seen], times_s, band, known)
    level = found.floor[int(np.abs(found.freqs_hz - tone.hz).argmin())]
    peak = replace(_peak(tone, level, is_seen, model_share), requested=tone)
    return replace(found, peaks=(*found.peaks, peak))


def _levels(found: Lines, grid: np.ndarray) -> np.ndarray:
    """Return the noise's standard deviation [F, A] at frequencies [F]."""
    return np.stack([np.interp(grid, found.hz, level) for level in found.noise.T], 1)


def _peak(
    line: Line | BandLine, level: np.ndarray, is_seen: np.ndarray, model_share: np.ndarray | None
) -> Peak:
    """Return a peak along all axes: 0 with infinite deviation along axes that are not observed."""
    phasor, deviation = np.zeros(len(is_seen), complex), np.full(len(is_seen), np.inf)
    phasor[is_seen], deviation[is_seen] = line.phasor, line.amplitude_deviation
    if model_share is not None:
        deviation = np.hypot(deviation, model_share * np.linalg.norm(phasor[is_resolved(level)]))
    return Peak(
        line.hz, line.hz_deviation, phasor, deviation, level, line if isinstance(line, Line) else None
    )


def ordered(peaks: Sequence[Peak]) -> tuple[Peak, ...]:
    """Sort by falling amplitude over the floor."""
    return tuple(sorted(peaks, key=strength_of, reverse=True))


def with_harmonics(peaks: Sequence[Peak], times_s: np.ndarray) -> tuple[Peak, ...]:
    """Mark the peaks of a record at these times that may be a harmonic of a stronger one."""
    step = float(np.median(np.diff(times_s)))
    size = [size_of(p) for p in peaks]
    hz, deviation = [p.frequency_hz for p in peaks], [p.frequency_deviation_hz for p in peaks]
    found = harmonics_of(hz, deviation, size, 1 / step, 1 / (step * len(times_s)))
    return tuple(replace(p, harmonic=h) for p, h in zip(peaks, found, strict=True))


def size_of(peak: Peak) -> float:
    """Return the amplitude along the resolved axes, scene units."""
    return float(np.linalg.norm(peak.amplitude[peak.is_resolved]))


def _uncertainty(peak: Peak) -> float:
    """Return the deviation of `size_of`."""
    size = size_of(peak)
    some = peak.is_resolved
    return float(np.linalg.norm(peak.amplitude[some] * peak.deviation[some])) / size if size else np.inf


def strength_of(peak: Peak) -> float:
    """Return the largest amplitude over floor of all axes."""
    scale = np.where(np.isfinite(peak.floor), np.maximum(peak.floor, 1e-300), np.inf)
    return float((peak.amplitude / scale).max())


def with_sidebands(
    peaks: Sequence[Peak], period: int | None, fps: float, duration_s: float
) -> tuple[Peak, ...]:
    """Mark weak peaks that may be a stronger one's sideband. period: frames, `codec_period`."""
    if period is None:
        return tuple(peaks)
    carriers = [k * fps / period for k in range(1, period // 2 + 1)]
    return tuple(replace(p, sideband=_sideband_of(p, peaks, carriers, fps, duration_s)) for p in peaks)


def _sideband_of(
    peak: Peak, peaks: Sequence[Peak], carriers: Sequence[float], fps: float, duration_s: float
) -> Sideband | None:
    for other in sorted(peaks, key=size_of, reverse=True):
        largest, smallest = (
            size_of(other) + TWICE * _uncertainty(other),
            size_of(peak) - TWICE * _uncertainty(peak),
        )
        if other is peak or largest < WEAKER * smallest:
            return None
        error = SURE * (peak.frequency_deviation_hz**2 + other.frequency_deviation_hz**2) ** 0.5
        for carrier in carriers:
            for is_sum in (False, True):
                hz = carrier + other.frequency_hz if is_sum else abs(carrier - other.frequency_hz)
                if abs(alias(hz, fps) - peak.frequency_hz) < max(NEAR / duration_s, error):
                    return Sideband(carrier, other.frequency_hz, is_sum)
    return None


@dataclass(frozen=True)
class Hidden:
    """A direction that is not resolved."""

    direction: np.ndarray  # [A] unit vector
    amplitude: float  # scene units, zero to peak
    deviation: float


@dataclass(frozen=True)
class Orbit:
    """The ellipse of Re[m exp(iωt)]: m = exp(iφ) (major + i minor), with major ⟂ minor."""

    major: np.ndarray  # [A] scene units: half axis, its largest component positive
    minor: np.ndarray  # [A]
    phase: float  # radians, φ: the major axis is passed at ωt = −φ
    deviation: float = 0.0  # of the half axis, scene units
    hidden: tuple[Hidden, ...] = ()

    @property
    def direction(self) -> np.ndarray:
        """Unit vector [A] along the major axis."""
        return self.major / max(float(np.linalg.norm(self.major)), 1e-300)

    @property
    def amplitude(self) -> float:
        """Amplitude along the major axis, scene units, zero to peak."""
        return float(np.linalg.norm(self.major))

    @property
    def stands_out(self) -> bool:
        """Return whether the half axis exceeds twice its deviation."""
        return self.amplitude > TWICE * self.deviation


def orbit_of(peak: Peak) -> Orbit:
    """Return the orbit of a peak, in the resolved directions."""
    return orbit_in(peak.phasor, peak.deviation, peak.is_resolved, peak.correlation)


def orbit_in(
    phasor: np.ndarray, deviation: np.ndarray, some: np.ndarray, correlation: np.ndarray | None = None
) -> Orbit:
    """Return the orbit of a phasor [A] along the axes `some` [A], with deviations [A] of correlation [A, A] or none."""
    error = np.where(some, deviation, 0.0)
    covariance = np.diag(error**2) if correlation is None else correlation * np.outer(error, error)
    covariance[~some] = covariance[:, ~some] = 0
    own = np.flatnonzero(some)
    values, vectors = np.linalg.eigh(covariance[np.ix_(own, own)])
    directions = np.zeros((len(phasor), len(own)))
    directions[own] = vectors
    variances, along = np.maximum(values, 0), directions.T @ phasor
    hidden: list[Hidden] = []
    found = _ellipse(directions @ along, covariance)
    for k in range(len(own) - 1, 0, -1):
        size, sure = float(np.abs(along[k])), float(np.sqrt(variances[k]))
        is_worse = variances[k] > TWICE**2 * variances[:k].sum()
        if size > TWICE * sure or not (is_worse or not found.stands_out):
            break
        hidden.append(Hidden(directions[:, k], size, sure))
        kept = directions[:, :k]
        found = _ellipse(kept @ along[:k], kept * variances[:k] @ kept.T)
    return Orbit(found.major, found.minor, found.phase, found.deviation, tuple(hidden))


def _ellipse(m: np.ndarray, covariance: np.ndarray) -> Orbit:
    """Turn the phasor m [A] so that its real and imaginary part are perpendicular."""
    phase = 0.5 * float(np.angle((m**2).sum()))
    turned = m * np.exp(-1j * phase)
    major, minor = turned.real, turned.imag
    if major[np.abs(major).argmax()] < 0:
        major, minor, phase = -major, -minor, phase + np.pi
    direction = major / max(float(np.linalg.norm(major)), 1e-300)
    deviation = float(np.sqrt(max(direction @ covariance @ direction, 0.0)))
    return Orbit(major, minor, float((phase + np.pi) % (2 * np.pi) - np.pi), deviation)


def main_is_above(peak: Peak, orbit: Orbit) -> bool:
    """Return whether a peak is a line, requested, or above the floor, and its main axis above twice its deviation."""
    is_resolved = peak.line is not None or peak.requested is not None or bool(peak.is_above.any())
    return is_resolved and orbit.stands_out
