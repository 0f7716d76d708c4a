"""Averaged spectra of one record and of two: Welch's density with its interval, waterfall, H1 and H2, coherence.

A second instrument beside the film has a clock of its own, whose lag is estimated first.

The lag has the highest correlation of the film and an accelerometer, converted to the same quantity, if no other lag
does nearly as well; then a and τ of y(t) = a x(t − τ) are fitted, and the lag's deviation is the effect of the
residual, with its spectrum, on τ (sandwich estimate).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.signal import correlate, correlation_lags, csd, get_window, spectrogram, welch
from scipy.stats import chi2

from tg4mm.core.lines import fit_lines
from tg4mm.show.analyse.channel import ORDER, AnalyseError, Channel
from tg4mm.show.analyse.quantities import Value, band_of, continued, converted
from tg4mm.show.options import AveragingOptions

_SEGMENTS = 9  # half segments in a record, where no length is given: eight averages
_SHORTEST = 8  # samples of a segment
_USED = 0.4  # of the slower rate: transfer functions end there
_FEWEST = 32  # common samples of both records
_SMOOTH = 15  # frequencies over which the residual's power is averaged
_FITS = 12
_ALIKE = 0.95  # of the power that the best lag explains: another one that explains so much is equivalent
_CHANCE = 0.01  # of a wrong lag
_FREEDOMS = 2.5  # averages from which coherence gives a deviation


@dataclass(frozen=True)
class Averaging(AveragingOptions):
    """Division of a record into segments: window (scipy's name), seconds (None: eight averages), share of overlap."""

    def cut(self, channel: Channel) -> tuple[int, int]:
        """Return the samples of a segment, and those that two share. Raises AnalyseError for a short record."""
        n, usual = len(channel.values), max(_SHORTEST, 2 * len(channel.values) // _SEGMENTS)
        length = usual if self.segment_s is None else round(self.segment_s * channel.rate)
        if not 0 <= self.overlap < 1:
            raise AnalyseError(f"--overlap {self.overlap:g}, expected 0 or more and below 1")
        try:
            get_window(self.window, 8)
        except ValueError:
            raise AnalyseError(f"--window {self.window!r} is unknown to scipy.signal.get_window") from None
        if not _SHORTEST <= length <= n:
            raise AnalyseError(
                f"{channel.name}: a segment of {length} samples, expected {_SHORTEST} to the record's {n}"
            )
        return length, min(int(self.overlap * length), length - 1)

    def count(self, channel: Channel) -> int:
        """Return the number of segments."""
        length, shared = self.cut(channel)
        return 1 + (len(channel.values) - length) // (length - shared)

    def freedom(self, channel: Channel) -> float:
        """Return the degrees of freedom of the average's χ²; overlapping segments count less (Welch 1967)."""
        (length, shared), count = self.cut(channel), self.count(channel)
        window, step = get_window(self.window, length), length - shared
        total = 1.0
        for k in range(1, min(count, 1 + (length - 1) // step)):
            rho = (window[: length - k * step] @ window[k * step :]) / (window @ window)
            total += 2 * (1 - k / count) * rho**2
        return 2 * count / total


def averaging_of(options: AveragingOptions) -> Averaging:
    """Return how the options of a command cut a record."""
    return Averaging(options.window, options.segment_s, options.overlap)


@dataclass(frozen=True)
class Density:
    """A one-sided density, unit² / Hz; low and high bound the truth in 95 records of 100, at each frequency."""

    channel: str
    unit: str
    freqs_hz: np.ndarray  # [F]
    density: np.ndarray  # [F]
    low: np.ndarray  # [F]
    high: np.ndarray  # [F]
    noise: float  # density of the channel's noise; nan: not stated
    averages: int
    freedom: float


def density_of(channel: Channel, averaging: Averaging | None = None) -> Density:
    """Return the power spectral density of a channel, with 95 % intervals."""
    averaging = averaging or Averaging()
    length, shared = averaging.cut(channel)
    freqs, power = welch(channel.values, channel.rate, averaging.window, length, shared)
    freedom = averaging.freedom(channel)
    low, high = freedom / chi2.isf(0.025, freedom), freedom / chi2.ppf(0.025, freedom)
    noise = 2 * channel.noise**2 / channel.rate
    return Density(
        channel.name, f"({channel.unit})²/Hz", freqs, power, power * low, power * high, noise,
        averaging.count(channel), freedom,
    )  # fmt: skip


def waterfall_of(
    channel: Channel, averaging: Averaging | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Hz [F], seconds [S], and amplitudes [F, S], zero to peak, of each segment."""
    averaging = averaging or Averaging()
    length, shared = averaging.cut(channel)
    freqs, times, power = spectrogram(
        channel.values, channel.rate, averaging.window, length, shared, scaling="spectrum"
    )
    return freqs, times + channel.times_s[0], np.sqrt(2 * power)


@dataclass(frozen=True)
class Transfer:
    """The transfer function of a response over an input, in `unit`; `deviation` is that of |H1|."""

    response: str
    reference: str
    unit: str
    freqs_hz: np.ndarray  # [F]
    h1: np.ndarray  # [F] complex
    h2: np.ndarray  # [F] complex
    coherence: np.ndarray  # [F]; always 1 for one average
    deviation: np.ndarray  # [F]
    phase_deviation: np.ndarray  # [F] radians, with the lag's; π at most
    lag_s: Value  # the film's clock minus the instrument's
    averages: int


def lag_of(response: Channel, reference: Channel) -> Value:
    """Return by how many seconds the response's clock is ahead: an event at t is in the response at t + lag.

    Raises AnalyseError for a force, whose response may have any phase, and if no lag or several fit.
    """
    if reference.quantity not in ORDER:
        raise AnalyseError(
            f"{reference.name} is {reference.quantity}, which cannot determine the lag: name an accelerometer of "
            "the same file with --sync, or give --lag"
        )
    lo = 2.0 / min(response.duration_s, reference.duration_s)
    hi = _USED * min(response.rate, reference.rate)
    y = converted(response, reference.quantity, (lo, hi))[0]
    spline = CubicSpline(reference.times_s, converted(reference, reference.quantity, (lo, hi))[0])
    grid = np.arange(reference.times_s[0], reference.times_s[-1], 1 / response.rate)
    if min(len(grid), len(y)) < _FEWEST:
        raise AnalyseError(f"{response.name}: under {_FEWEST} samples cannot determine the lag")
    x = spline(grid)
    cross, lags = correlate(y, x, "full"), correlation_lags(len(y), len(x))
    both = np.rint(correlate(np.ones(len(y)), np.ones(len(x)), "full"))
    energy = correlate(np.ones(len(y)), x**2, "full") * correlate(y**2, np.ones(len(x)), "full")
    enough = (both >= min(len(x), len(y)) / 2) & (energy > 1e-12 * energy.max())
    explained = np.where(enough, np.clip(cross**2 / np.where(enough, energy, 1), 0, 1 - 1e-9), 0)
    best, independent = int(explained.argmax()), 2 * (hi - lo) * min(len(x), len(y)) / 2 / response.rate
    turns = np.flatnonzero(np.sign(cross) != np.sign(cross[best]))
    first, last = turns[turns < best].max(initial=-1) + 1, turns[turns > best].min(initial=len(cross))
    others = explained.copy()
    others[first:last] = 0
    rival = int(others.argmax())
    likelier = independent / 2 * np.log((1 - others[rival]) / (1 - explained[best]))
    if likelier < np.log(1 / _CHANCE) or others[rival] > _ALIKE * explained[best]:
        raise AnalyseError(
            f"{response.name} and {reference.name} repeat themselves or have nothing in common, so the lag is "
            f"ambiguous: one that is {abs(lags[rival] - lags[best]) / response.rate:.4g} s off fits as well; give it "
            "with --lag SECONDS"
        )
    lag = lags[best] / response.rate + response.times_s[0] - reference.times_s[0]
    return _refined(response, y, spline, lag)


def _refined(response: Channel, y: np.ndarray, spline: CubicSpline, lag: float) -> Value:
    """Fit lag and factor, from a lag within half a period."""
    first, last = spline.x[0], spline.x[-1]
    deviation = float("inf")
    for _ in range(_FITS):
        t = response.times_s - lag
        inside = (t >= first) & (t <= last)
        if inside.sum() < _FEWEST:
            raise AnalyseError(
                f"{response.name} and the other record overlap by only {int(inside.sum())} samples at a lag of "
                f"{lag:.4g} s, at least {_FEWEST} are needed; check --lag"
            )
        x, slope, own = spline(t[inside]), spline(t[inside], 1), y[inside]
        size = float(x @ own / max(x @ x, 1e-300))
        residual, g = own - size * x, -size * slope
        g = g - x * float(x @ g / max(x @ x, 1e-300))
        step = float(g @ residual / max(g @ g, 1e-300))
        power = uniform_filter1d(np.abs(np.fft.fft(residual)) ** 2, _SMOOTH, mode="wrap")
        variance = float((np.abs(np.fft.fft(g)) ** 2 * power).mean()) / len(g)
        deviation = float(np.sqrt(variance)) / max(float(g @ g), 1e-300)
        lag += float(np.clip(step, -0.5 / response.rate, 0.5 / response.rate))
        if abs(step) < 1e-3 * deviation:
            break
    return Value(lag, deviation)


def shared(response: Channel, reference: Channel, lag: Value) -> tuple[Channel, Channel]:
    """Return both over their common time, by the response's clock and rate; the input is low-passed first."""
    t = response.times_s - lag.value
    inside = np.flatnonzero((t >= reference.times_s[0]) & (t <= reference.times_s[-1]))
    if len(inside) < _FEWEST:
        raise AnalyseError(
            f"{response.name} and {reference.name} share {len(inside)} samples at the lag {lag.value:.4g} s, "
            f"expected {_FEWEST}"
        )
    values, n = reference.values, len(reference.values)
    if reference.rate > response.rate:
        f = np.fft.rfftfreq(3 * n - 2, 1 / reference.rate)
        edge = np.clip((f / response.rate - _USED) / (0.5 - _USED), 0, 1)
        long = np.fft.irfft(np.fft.rfft(continued(values)) * np.cos(np.pi / 2 * edge) ** 2, 3 * n - 2)
        values = long[n - 1 : 2 * n - 1]
    part = slice(inside[0], inside[-1] + 1)
    times, sampled = response.times_s[part], CubicSpline(reference.times_s, values)(t[part])
    own = replace(response, times_s=times, values=response.values[part])
    return own, replace(reference, times_s=times, values=sampled)


def transfer_of(
    response: Channel, reference: Channel, averaging: Averaging | None = None, lag: Value | None = None
) -> Transfer:
    """Return H1 = S_xy / S_xx and H2 = S_yy / S_yx with the input x. lag: None: by `lag_of`."""
    averaging, lag = averaging or Averaging(), lag or lag_of(response, reference)
    y, x = shared(response, reference, lag)
    length, overlap = averaging.cut(y)
    of = {"fs": y.rate, "window": averaging.window, "nperseg": length, "noverlap": overlap}
    freqs, cross = csd(x.values, y.values, **of)
    sxx, syy = (np.maximum(welch(c.values, **of)[1], 1e-300) for c in (x, y))
    coherence = np.minimum(np.abs(cross) ** 2 / (sxx * syy), 1.0)
    h1, averages = cross / sxx, averaging.freedom(y) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        h2 = np.where(np.abs(cross) > 0, syy / np.conj(cross), np.nan)
        known = np.nan_to_num(2 * y.noise**2 / y.rate) / (2 * averages * np.abs(h1) ** 2 * sxx)
        seen = np.maximum(coherence - (1 - coherence) ** 2 / averages, 0)
        by_coherence = (1 - seen) / (2 * averages * seen) if averages > _FREEDOMS else 0 * seen
    share = np.sqrt(np.maximum(known, by_coherence))
    if averages <= _FREEDOMS and not np.isfinite(y.noise):
        share = np.full(len(freqs), np.nan)
    turn = np.hypot(share, 2 * np.pi * freqs * lag.deviation)
    keep = (freqs > 0) & (freqs <= _USED * min(response.rate, reference.rate))
    size = np.abs(h1) * np.hypot(share, y.share)
    return Transfer(
        response.name, reference.name, f"{y.unit}/{x.unit}", freqs[keep], h1[keep], h2[keep], coherence[keep],
        size[keep], np.minimum(turn, np.pi)[keep], lag, averaging.count(y),
    )  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """A channel and an instrument, both as the instrument's quantity in a band, by the channel's clock."""

    channel: str
    reference: str
    unit: str
    band_hz: tuple[float, float]
    lag_s: Value
    times_s: np.ndarray  # [T]
    values: np.ndarray  # [T] the channel
    deviation: float  # of each; nan: not stated
    instrument: np.ndarray  # [T]
    ratio: Value  # the channel over the instrument, whose errors are not included
    difference_rms: float  # of the channel from ratio × instrument
    correlation: float


def curve_of(
    channel: Channel, reference: Channel, lag: Value, band: tuple[float, float] | None = None
) -> Curve:
    """Regress the channel on the instrument; the ± is from the residual, of 2 (hi − lo) T independent values.

    Raises AnalyseError for a reference that is not a motion, and for records that hardly overlap.
    """
    y, x = shared(channel, reference, lag)
    lo, hi = band_of(y, band)
    hi = min(hi, _USED * min(channel.rate, reference.rate))
    own, noise, inner = converted(y, reference.quantity, (lo, hi))
    other = converted(replace(x, noise=float("nan")), reference.quantity, (lo, hi))[0][inner]
    own, power = own[inner], max(float(other @ other), 1e-300)
    ratio = float(other @ own) / power
    left = own - ratio * other
    freedom = max(2 * (hi - lo) * len(own) / y.rate - 1, 1.0)
    sure = float(np.hypot(np.sqrt(float(left @ left) / power / freedom), y.share * ratio))
    return Curve(
        channel.name, reference.name, x.unit, (lo, hi), lag, y.times_s[inner], own, noise, other, Value(ratio, sure),
        float(np.sqrt((left**2).mean())), float(np.corrcoef(own, other)[0, 1]),
    )  # fmt: skip


@dataclass(frozen=True)
class Phase:
    """The phase of a channel against a reference channel at one of its lines."""

    channel: str
    reference: str
    frequency_hz: Value
    ratio: Value  # of amplitudes
    phase: Value  # radians, −π … π; positive: the channel is ahead


def phases_of(channels: list[Channel], reference: Channel) -> list[Phase]:
    """Return the phases at each line of the reference, of every channel on its times; deviations are at most π."""
    own, out = reference.lines, []
    for channel in channels if own else []:
        if channel is reference or not np.array_equal(channel.times_s, reference.times_s):
            continue
        found = fit_lines(channel.values, channel.times_s, own, np.nan_to_num(channel.noise)).lines
        for a, b in zip(own, found, strict=True):
            size, ratio = float(a.amplitude[0]), float(b.amplitude[0] / a.amplitude[0])
            spread = float(np.hypot(a.amplitude_deviation[0] * ratio, b.amplitude_deviation[0])) / size
            spread = float(np.hypot(spread, np.hypot(channel.share, reference.share) * ratio))
            angle = float(np.angle(b.phasor[0] / a.phasor[0]))
            turn = float(min(np.hypot(a.phase_deviation[0], b.phase_deviation[0]), np.pi))
            values = Value(a.hz, a.hz_deviation), Value(ratio, spread), Value(angle, turn)
            out.append(Phase(channel.name, reference.name, *values))
    return out
