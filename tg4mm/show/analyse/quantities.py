"""Displacement, velocity and acceleration in a band, and their levels, each with its standard deviation.

H(f) = (2πi f)ⁿ B(f), B(f) = 1 / (1 + (lo/f)⁸) · 1 / (1 + (f/hi)⁸): differentiation or integration, and a zero-phase
Butterworth filter of order 4. A record's lines are multiplied by it directly; the residual, continued at both ends by
its odd reflection, in its Fourier transform. White noise of deviation σ becomes σ √(mean |H|²).

Noise adds to a level θ (peak, rms …). So levels are computed from û: the lines, and the residual of u with its spectrum
multiplied by √(1 − noise / power), power smoothed over frequencies. Draws n of the same noise give û + n, which is
treated alike: the mean difference of its θ² from û's corrects θ², and its scatter is the deviation. The errors that
grow with the motion are added.

One-third-octave spectra have bands of base 10: midbands 1000 · 10^(n/10) Hz, edges 10^(±1/20) from them. The power in a
band is the sum of the record's periodogram (Hann window) between its edges, less the power of the channel's white noise
of deviation σ, 2σ²/rate a hertz. Noise n beside a signal s at one frequency scatters its power by √(2sn + n²); a Hann
window correlates neighbouring frequencies, so that the variance of a sum is 1.5 times that.

Zones of ISO 20816-1 by class of machine: velocity rms, 10 to 1000 Hz, on parts that do not rotate. The limits are those
of classes I to IV in public tables of ISO 10816-1:1995, annex B, which ISO 20816-1 succeeds; the standard, and its part
for a kind of machine, takes precedence. I small machines to 15 kW; II medium ones to 75 kW, or 300 kW on a separate
foundation; III large ones on a rigid, IV on a soft foundation.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d
from scipy.signal import periodogram

from tg4mm.core.lines import projected
from tg4mm.show.analyse.channel import ORDER, AnalyseError, Channel, G, unit_of

DRAWS = 64
_UP = 4  # samples to each of the record: its peaks lie between samples
_NEAR = 41  # frequencies of the record's transform over which its power is smoothed
_LONGEST = 8192  # samples of a record whose lines are separated from the residual
_CYCLES = 2.0  # of the lowest frequency in a record, where no band is given
# reference of dB where lengths are known (ISO 1683): mm, mm/s, mm/s²
DB_REFERENCE = {"displacement": 1e-9, "velocity": 1e-6, "acceleration": 1e-3}
_NARROWEST = 2.0  # frequencies of the periodogram, 1 / duration apart: the width of the lowest band
_CORRELATED = 1.5  # equivalent noise bandwidth of the Hann window, in frequencies
BAND_HZ = 10.0, 1000.0
LIMITS = {  # mm/s rms: A to B, B to C, C to D
    "I": (0.71, 1.8, 4.5), "II": (1.12, 2.8, 7.1), "III": (1.8, 4.5, 11.2), "IV": (2.8, 7.1, 18.0),
}  # fmt: skip
_ZONE_CYCLES = 10  # of the band's lowest frequency in a record
_SURE = 2.0  # deviations


@dataclass(frozen=True)
class Value:
    """A number with its standard deviation; nan: not stated."""

    value: float
    deviation: float


@dataclass(frozen=True)
class Levels:
    """Levels of a channel as one quantity, in `unit`; acceleration also in g where lengths are known."""

    channel: str
    quantity: str
    unit: str
    band_hz: tuple[float, float]
    peak: Value
    peak_to_peak: Value
    rms: Value
    crest: Value  # and dB: nan where the rms is less than twice its deviation
    db: Value  # of rms
    db_reference: str
    rms_g: Value | None = None


def band_of(channel: Channel, band: tuple[float, float] | None = None) -> tuple[float, float]:
    """Return the band as given, or from two cycles in the record to half the rate. Raises AnalyseError if empty."""
    half = channel.rate / 2
    lo, hi = band or (_CYCLES / channel.duration_s, half)
    if not 0 <= lo < min(hi, half):
        raise AnalyseError(
            f"{channel.name}: no part of the band {lo:g} to {hi:g} Hz is below half its rate, {half:g} Hz"
        )
    return lo, min(hi, half)


def converted(
    channel: Channel, quantity: str, band: tuple[float, float] | None = None, times: int = 1
) -> tuple[np.ndarray, float, slice]:
    """Return the channel as `quantity` in the band [T · times], the deviation of its noise, and the part without ends.

    Raises AnalyseError for a channel that is not a motion and another quantity, and for an integral from 0 Hz.
    """
    operator = _BandOperator(channel, quantity, band, times)
    return operator(channel.values, 0.0), channel.noise * operator.noise_gain, operator.inner


class _BandOperator:
    def __init__(self, channel: Channel, quantity: str, band: tuple[float, float] | None, times: int) -> None:
        is_same = quantity == channel.quantity
        if not is_same and (channel.quantity not in ORDER or quantity not in ORDER):
            raise AnalyseError(f"{channel.name} is {channel.quantity}, which cannot be made {quantity}")
        order = 0 if is_same else ORDER[quantity] - ORDER[channel.quantity]
        lo, hi = band_of(channel, band)
        if order < 0 and lo <= 0:
            raise AnalyseError(f"{channel.name}: an integral needs a band that begins above 0 Hz")
        n = self.length = len(channel.values)
        self.times, self.total = times, min(next_fast_len(int(2.8 * n), real=True), 3 * n - 2)
        f = np.fft.rfftfreq(self.total, 1 / channel.rate)
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = (2j * np.pi * f) ** order / (1 + (lo / f) ** 8)
        gain[0] = 0 if lo > 0 or order else 1
        if hi < channel.rate / 2:
            gain = gain / (1 + (f / hi) ** 8)
        self.gain = gain
        self.time, fine = channel.times_s, channel.times_s[0] + np.arange(n * times) / (channel.rate * times)
        lines = channel.lines if n <= _LONGEST else ()
        self.lines = [line for line in lines if line.start_s is None]
        self.out = []  # each line with the phasor 1, converted
        for line in self.lines:
            h = (2j * np.pi * line.hz - line.decay_per_s) ** order / (1 + (lo / line.hz) ** 8)
            h = h / (1 + (line.hz / hi) ** 8) if hi < channel.rate / 2 else h
            self.out.append(h * line.envelope(fine) * np.exp(2j * np.pi * line.hz * fine))
        both = np.concatenate([gain, gain[1:]])  # of both signs of the frequency
        self.noise_gain = float(np.sqrt((np.abs(both) ** 2).mean()))
        cut = max(2, min(n // 8, int(np.ceil(channel.rate / lo - 1e-6)) if lo > 0 else n // 50))
        self.inner = slice(cut * times, (n - cut) * times)

    def __call__(self, values: np.ndarray, noise: float) -> np.ndarray:
        """Convert [T] to [T · times]; the power of white noise of that deviation is subtracted from the residual's."""
        phasors, rest = self._separated(values, noise)
        up = np.fft.irfft(rest * self.gain, self.total * self.times) * self.times
        up = up[(self.length - 1) * self.times : (2 * self.length - 1) * self.times]
        return np.asarray(sum((p * out).real for p, out in zip(phasors, self.out, strict=True)) + up)

    def denoised(self, values: np.ndarray, noise: float) -> np.ndarray:
        """Return the record [T] without the power of the noise."""
        phasors, rest = self._separated(values, noise)
        residual = np.fft.irfft(rest, self.total)[self.length - 1 : 2 * self.length - 1]
        return np.asarray(residual + self._sum(phasors))

    def _sum(self, phasors: np.ndarray) -> np.ndarray:
        t, out = self.time, np.zeros(self.length)
        for p, line in zip(phasors, self.lines, strict=True):
            out += (p * line.envelope(t) * np.exp(2j * np.pi * line.hz * t)).real
        return out

    def _separated(self, values: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the lines' phasors, and the transform of the residual without noise."""
        phasors = np.zeros(0, complex)
        if self.lines:
            phasors = projected(self.lines, values[:, None], self.time)[:, 0]
            values = values - self._sum(phasors)
        spectrum = np.fft.rfft(continued(values - values.mean())[: self.total])
        if noise > 0:
            power = uniform_filter1d(np.abs(spectrum) ** 2, 3 * _NEAR, mode="nearest")
            spectrum *= np.sqrt(np.clip(1 - noise**2 * self.total / np.maximum(power, 1e-300), 0, 1))
        return phasors, spectrum


def continued(values: np.ndarray) -> np.ndarray:
    """Continue [T] to [3T − 2] by its odd reflection at both ends."""
    return np.concatenate([2 * values[0] - values[:0:-1], values, 2 * values[-1] - values[-2::-1]])


def levels_of(channel: Channel, quantity: str, band: tuple[float, float] | None = None) -> Levels:
    """Return peak, peak to peak, rms, crest factor and dB of a channel as `quantity`, without the record's ends."""
    operator = _BandOperator(channel, quantity, band, _UP if len(channel.values) <= _LONGEST else 1)
    noise = float(np.nan_to_num(channel.noise))
    found = _figures(operator(channel.values, noise)[operator.inner])
    deviation = np.full(4, np.nan)
    if np.isfinite(channel.noise):
        rng, clean = np.random.default_rng(0), operator.denoised(channel.values, noise)
        noisy = [clean + noise * rng.normal(size=operator.length) for _ in range(DRAWS)]
        squares = np.array([_figures(operator(one, noise)[operator.inner]) for one in noisy]) ** 2
        bias = squares.mean(0) - _figures(operator(clean, 0.0)[operator.inner]) ** 2
        # The noise is estimated, which makes the bias uncertain; a peak's more so, since a record's noise has chosen
        # which of many nearly equal peaks is the highest.
        sure = np.hypot(squares.std(0, ddof=1), bias * [1, 1, 0.5, 0.5])
        found = np.sqrt(np.maximum(found**2 - bias, [0, 0, 0, 1]))
        deviation = root_deviation(found, sure)
        deviation[:3] = np.hypot(deviation[:3], channel.share * found[:3])
    peak, peak_to_peak, rms, crest = (
        Value(float(v), float(d)) for v, d in zip(found, deviation, strict=True)
    )
    unit = unit_of(quantity, channel.base)
    reference = DB_REFERENCE[quantity] if channel.base == "mm" else 1.0
    if rms.value > 2 * np.nan_to_num(rms.deviation):
        per_rms = 20 / np.log(10) / rms.value
        db = Value(20 * float(np.log10(rms.value / reference)), float(per_rms * rms.deviation))
    else:  # the rms may be 0: its dB and a ratio to it are unbounded
        crest = db = Value(float("nan"), float("nan"))
    in_g = quantity == "acceleration" and channel.base == "mm"
    return Levels(
        channel.name, quantity, unit, band_of(channel, band), peak, peak_to_peak, rms, crest, db,
        f"{reference:g} {unit}",
        Value(rms.value / G, rms.deviation / G) if in_g else None,
    )  # fmt: skip


def root_deviation(value: np.ndarray, of_square: np.ndarray) -> np.ndarray:
    """Return the standard deviations of roots, of which the squares have the deviations `of_square`.

    Two deviations below the value, its square is lower by two of its own deviations; for a strong vibration each is
    of_square / (2 value).
    """
    lower = np.sqrt(np.maximum(value**2 - 2 * of_square, 0))
    return np.asarray(np.where(lower > 0, (value - lower) / 2, np.sqrt(of_square / 2)))


def _figures(values: np.ndarray) -> np.ndarray:
    """Return peak, peak to peak, rms and crest factor [4]."""
    peak, rms = float(np.abs(values).max()), float(np.sqrt((values**2).mean()))
    return np.array([peak, float(np.ptp(values)), rms, peak / max(rms, 1e-300)])


@dataclass(frozen=True)
class ThirdOctave:
    """The rms of a channel, as one quantity, in one band; lengths in the channel's unit."""

    channel: str
    quantity: str
    unit: str
    midband_hz: float
    band_hz: tuple[float, float]
    rms: Value


def midbands(lowest_hz: float, highest_hz: float) -> np.ndarray:
    """Return the midband frequencies [B], Hz, of bands that lie between two frequencies."""
    first = int(np.ceil(10 * np.log10(lowest_hz / 1000) + 0.5 - 1e-9))
    last = int(np.floor(10 * np.log10(highest_hz / 1000) - 0.5 + 1e-9))
    return np.asarray(1000 * 10 ** (np.arange(first, last + 1) / 10))


def third_octaves_of(channel: Channel, quantity: str) -> Iterator[ThirdOctave]:
    """Yield the bands of a channel as a quantity, from the lowest that the record resolves to half its rate.

    quantity: the channel's, or displacement, velocity or acceleration as a derivative or integral of it.
    """
    step = 1 / channel.duration_s
    lowest_hz = _NARROWEST * step / (10**0.05 - 10**-0.05) * 10**-0.05
    hz, power = periodogram(channel.values, channel.rate, "hann", detrend="linear")
    order = ORDER[quantity] - ORDER[channel.quantity] if quantity != channel.quantity else 0
    with np.errstate(divide="ignore"):
        gain = (2 * np.pi * hz) ** (2.0 * order)
    width = hz[1] - hz[0]
    noise = 2 * channel.noise**2 / channel.rate * width * gain
    power = power * width * gain
    for middle in midbands(lowest_hz, channel.rate / 2):
        low, high = float(middle * 10**-0.05), float(middle * 10**0.05)
        inside = np.clip((np.minimum(hz + width / 2, high) - np.maximum(hz - width / 2, low)) / width, 0, 1)
        own = inside > 0
        signal = power[own] - np.nan_to_num(noise[own])
        scatter = 2 * np.maximum(signal, 0) * noise[own] + noise[own] ** 2
        rms = np.sqrt(max(float(inside[own] @ signal), 0))
        deviation = root_deviation(rms, np.sqrt(_CORRELATED * inside[own] @ scatter))
        value = Value(float(rms), float(np.hypot(deviation, channel.share * rms)))
        unit = unit_of(quantity, channel.base)
        yield ThirdOctave(channel.name, quantity, unit, float(middle), (low, high), value)


@dataclass(frozen=True)
class Zone:
    """The zone of a channel: a letter, or two where twice the deviation reaches into the next; with its limits."""

    channel: str
    machine: str
    rms: Value  # mm/s
    zone: str
    notes: tuple[str, ...]


def zone_of(channel: Channel, machine: str) -> Zone:
    """Return the zone. Raises AnalyseError for an unknown class, and for a channel of unsuitable unit or rate."""
    if machine not in LIMITS:
        raise AnalyseError(f"--machine-class {machine!r} is unknown; classes: {', '.join(LIMITS)}")
    if channel.base != "mm":
        raise AnalyseError(f"{channel.name} is in {channel.unit}: a zone needs millimetres (docs/scale.md)")
    if channel.rate / 2 <= BAND_HZ[0]:
        raise AnalyseError(
            f"{channel.name}: half its rate, {channel.rate / 2:g} Hz, is below the band of a zone, 10 to 1000 Hz"
        )
    rms, notes, half = levels_of(channel, "velocity", BAND_HZ).rms, [], channel.rate / 2
    ends = [rms.value + k * _SURE * np.nan_to_num(rms.deviation) for k in (-1, 1)]
    low, high = ("ABCD"[int(np.searchsorted(LIMITS[machine], end))] for end in ends)
    if half < BAND_HZ[1]:
        notes.append(f"the record ends at {half:g} Hz of 10 to 1000 Hz: the zone is {low} or worse")
    if channel.duration_s * BAND_HZ[0] < _ZONE_CYCLES:
        notes.append(
            f"the record of {channel.duration_s:.2g} s holds fewer than {_ZONE_CYCLES} periods of 10 Hz"
        )
    if not np.isfinite(rms.deviation):
        notes.append("the record states no noise: the value has no deviation")
    return Zone(channel.name, machine, rms, low if low == high else f"{low} or {high}", tuple(notes))
