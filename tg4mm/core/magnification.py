"""The magnification: frequency bands that do not overlap, each with its own α, and the temporal filters.

A filter is applied by its frequency response on the DFT bins of T timesteps. `zero-phase`: a Hamming-windowed FIR of
odd length about its centre tap; its response is real, so the result is neither late nor early. `ideal`: 1 inside the
band, 0 outside. `published`: the FIR of even length N of [TG4MM] and [3DMM], put through `ifftshift` and the FFT. It
has no centre tap, so the result is half a sample early: 18° at 3 Hz and 30° at 5 Hz with fps 30, a motion that is 31
% and 52 % off (2 sin(θ/2)), which α then multiplies.

Filtering over T timesteps takes the series as periodic, as the FFT does; a response is a function of frequency, so T
need not be the filter's length. Shorter than the filter, the series wraps around within it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from tg4mm.core.choices import FILTERS, METHODS
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.values import Number

LARGEST_ALPHA = 1e6  # either way; a micrometre becomes a metre, and far beyond it float32 overflows

_AT_ONCE = 1 << 16  # series filtered at a time, bounds the memory of the spectra


@dataclass(frozen=True)
class TemporalFilter:
    """A temporal filter and its length. taps 0: one second of the capture, as in [TG4MM] (odd for `zero-phase`)."""

    kind: str = "zero-phase"
    taps: int = 0

    def checked(self) -> "TemporalFilter":
        """Return itself. Raises Tg4mmError for an unknown kind, and a length of the wrong parity."""
        if self.kind not in FILTERS:
            raise Tg4mmError(f"filter is {self.kind!r}, expected {', '.join(FILTERS)}")
        wrong = self.taps % 2 == 0 if self.kind == "zero-phase" else self.taps % 2 == 1
        if self.taps != 0 and (self.taps < 3 or (self.kind != "ideal" and wrong)):
            parity = {"zero-phase": "an odd number", "published": "an even number"}.get(self.kind, "a number")
            raise Tg4mmError(f"filter length is {self.taps}, expected {parity} of at least 3, or 0")
        return self

    def length(self, fps: float) -> int:
        """Taps at a frame rate: 31 (`zero-phase`) and 30 (`published`) at 30 Hz."""
        even = 2 * max(round(fps / 2), 2)
        return self.taps or (even if self.kind == "published" else even + 1)

    def response(self, band: tuple[float, float], freqs_hz: ArrayLike, fps: float) -> np.ndarray:
        """Return [K] complex128: the factor that a component exp(+i 2π f t / fps) of each frequency gets.

        band (low, high) in Hz, 0 ≤ low < high < fps/2; low 0 makes it a low-pass, which keeps 0 Hz.
        """
        freqs = np.asarray(freqs_hz, np.float64)
        if self.kind == "ideal":
            return ((freqs >= band[0]) & (freqs <= band[1])).astype(np.complex128)
        taps, lags = fir(band, self.length(fps), fps)
        return np.exp(-2j * np.pi * np.outer(freqs, lags) / fps) @ taps


def fir(band: tuple[float, float], length: int, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (taps [N], their lags [N] in samples) of a Hamming-windowed FIR; gain 1 at the band's centre.

    An odd length has its centre tap at lag 0. An even one has its centre between two, of which `ifftshift` (on
    length N) brings the later, tap N/2, to lag 0.
    """
    from scipy.signal import firwin

    low, high = band
    edges = high if low <= 0 else [low, high]
    taps = firwin(length, edges, window="hamming", pass_zero=low <= 0, fs=fps)
    return taps, np.arange(length) - length // 2


def apply_response(series: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Filter a series [T, …] along time by a response [T // 2 + 1] on the bins of `np.fft.rfftfreq(T)`.

    float32 in, float32 out; other real types as float64. Raises ValueError where the two do not fit.
    """
    n = len(series)
    if response.shape != (n // 2 + 1,):
        raise ValueError(f"response has shape {response.shape}, expected {(n // 2 + 1,)} for T = {n}")
    import scipy.fft

    flat = np.ascontiguousarray(series).reshape(n, -1)
    kind = np.float32 if flat.dtype == np.float32 else np.float64
    out = np.empty(flat.shape, kind)
    factor = response.astype(np.complex64 if kind is np.float32 else np.complex128)[:, None]
    for start in range(0, flat.shape[1], _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        out[:, part] = scipy.fft.irfft(scipy.fft.rfft(flat[:, part], axis=0) * factor, n, axis=0)
    return out.reshape(series.shape)


def bins(n_timesteps: int, fps: float) -> np.ndarray:
    """Return [T // 2 + 1] frequencies in Hz of the DFT bins of T timesteps."""
    return np.fft.rfftfreq(n_timesteps, 1 / fps)


def check_band(band: Sequence[float], fps: float) -> tuple[float, float]:
    """The band as (low, high) in Hz, if 0 ≤ low < high < fps / 2; CaptureError otherwise."""
    low, high = _pair(band)
    if not (math.isfinite(fps) and fps > 0):
        raise CaptureError(f"band ({low:g}, {high:g}) Hz needs a frame rate, and fps is {fps:g} (unknown)")
    if low < 0:
        raise CaptureError(f"band ({low:g}, {high:g}) Hz starts below 0 Hz")
    if low >= high:
        raise CaptureError(f"band ({low:g}, {high:g}) Hz is empty: low must be below high")
    if high >= fps / 2:
        raise CaptureError(
            f"band ({low:g}, {high:g}) Hz reaches past half the frame rate, {fps / 2:g} Hz (fps = {fps:g})"
        )
    return low, high


def _pair(band: Sequence[float]) -> tuple[float, float]:
    numbers = list(band) if isinstance(band, Sequence) and not isinstance(band, str) else []
    if len(numbers) != 2 or not all(Number().fits(x) for x in numbers):
        raise CaptureError(f"band {band!r} is not two frequencies in Hz, low and high")
    return float(numbers[0]), float(numbers[1])


@dataclass(frozen=True)
class BandGain:
    """A band and its magnification: displacements δ at frequencies from low to high become (1 + alpha) δ.

    alpha = 0 changes nothing, −1 stops the motion, and values between attenuate it. Below −1 the motion is inverted:
    |1 + alpha| times as large, in opposite phase.
    """

    low: float  # Hz
    high: float  # Hz
    alpha: float  # magnification α

    @property
    def band(self) -> tuple[float, float]:
        """Return (low, high) in Hz."""
        return self.low, self.high


@dataclass(frozen=True)
class Magnification:
    """Bands to magnify, each with its α, and the method.

    The method `modal` needs no filter: a mode lies inside a band or outside.
    """

    bands: tuple[BandGain, ...] = ()  # frequencies in none of them keep their motion
    everywhere: float = 0.0  # α of all frequencies if there are no bands
    # `modal`, `phase` or `linear`; None: the preset's own (modal: `modal`, paper: `phase`, paper-tuned: `linear`)
    method: str | None = None
    filter: TemporalFilter | None = None  # None: zero-phase
    # of `phase` alone, as [3DMM] has it for real captures: nothing but the bands moves; what of each sub-band is
    # weaker than this percentile of its amplitudes keeps its phase
    suppressed: bool = False
    amplitude_percentile: float = 0.0

    @classmethod
    def of(
        cls,
        alpha: float,
        *bands: tuple[float, float],
        method: str | None = None,
        filter: TemporalFilter | None = None,
    ) -> "Magnification":
        """The same α in each of the bands (low, high) in Hz; of all frequencies without any."""
        gains = tuple(BandGain(*_pair(band), alpha) for band in bands)
        return cls(gains, 0.0 if gains else alpha, method, filter)

    def times(self, alpha: float) -> "Magnification":
        """Replace every α by `alpha`."""
        magnified = Magnification.of(alpha, *self.limits, method=self.method, filter=self.filter)
        return replace(magnified, suppressed=self.suppressed, amplitude_percentile=self.amplitude_percentile)

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Return (low, high) of each band, Hz; () for all frequencies."""
        return tuple(b.band for b in self.bands)

    @property
    def alpha(self) -> float:
        """The largest α, either way."""
        return max((b.alpha for b in self.bands), key=abs, default=self.everywhere)

    def inside(self, freqs_hz: np.ndarray) -> np.ndarray:
        """Return [K] bool: which frequencies lie in a band, ends included; all of them without bands."""
        freqs = np.asarray(freqs_hz)
        if not self.bands:
            return np.full(freqs.shape, True)
        return np.any([(b.low <= freqs) & (freqs <= b.high) for b in self.bands], axis=0)

    def checked(self, fps: float) -> "Magnification":
        """Return itself if it is valid for the frame rate `fps` (Hz).

        Raises Tg4mmError for an unknown method, an α that is no number, and bands that overlap; CaptureError for a band
        that does not fit the frame rate.
        """
        if self.method is not None and self.method not in METHODS:
            raise Tg4mmError(f"method is {self.method!r}, expected {', '.join(METHODS)}")
        if self.filter is not None:
            self.filter.checked()
        for alpha in (self.everywhere, *(b.alpha for b in self.bands)):
            if not Number(-LARGEST_ALPHA, LARGEST_ALPHA).fits(alpha):
                raise Tg4mmError(f"alpha is {alpha!r}, expected a finite number within ±{LARGEST_ALPHA:g}")
        if self.bands and self.everywhere != 0:
            raise Tg4mmError(
                f"alpha {self.everywhere:g} for all frequencies and bands cannot be used together"
            )
        if not 0 <= self.amplitude_percentile < 100:
            raise Tg4mmError(
                f"amplitude percentile is {self.amplitude_percentile:g}, expected 0 to below 100"
            )
        if self.suppressed and not self.bands:
            raise Tg4mmError("other frequencies can be suppressed only with a band: give one")
        check_bands([b.band for b in self.bands], fps)
        return self

    @property
    def of_phase(self) -> dict[str, float | bool]:
        """The settings of the method `phase` that are not at their defaults, by name."""
        options = {"suppressed": self.suppressed, "amplitude_percentile": self.amplitude_percentile}
        return {name: value for name, value in options.items() if value}

    @property
    def is_identity(self) -> bool:
        """Return whether nothing is magnified."""
        return self.everywhere == 0 and all(b.alpha == 0 for b in self.bands) and not self.suppressed

    def ideal(self, freqs_hz: np.ndarray) -> np.ndarray:
        """Return [K] float64: the α of each frequency, 0 outside all bands."""
        freqs = np.asarray(freqs_hz, np.float64)
        gains = np.full(freqs.shape, self.everywhere)
        for b in self.bands:
            gains[(freqs >= b.low) & (freqs <= b.high)] = b.alpha
        return gains

    def response(self, freqs_hz: np.ndarray, fps: float) -> np.ndarray:
        """Return [K] complex128: Σ over bands of α times the filter's response at each frequency.

        Without bands the α of all frequencies, 0 Hz included: then a change since timestep 0 grows as a whole.
        """
        freqs = np.asarray(freqs_hz, np.float64)
        total = np.full(freqs.shape, self.everywhere, np.complex128)
        temporal = self.filter or TemporalFilter()
        for b in self.bands:
            total += (b.alpha + self.suppressed) * temporal.response(b.band, freqs, fps)
        return total


AS_CAPTURED = Magnification()


def check_bands(bands: Sequence[tuple[float, float]], fps: float) -> None:
    """Raise CaptureError for a band that does not fit `fps` (Hz), Tg4mmError for two that share a frequency."""
    ordered = sorted(check_band(band, fps) for band in bands)
    for (low, high), (next_low, next_high) in pairwise(ordered):
        if next_low <= high:
            raise Tg4mmError(
                f"bands ({low:g}, {high:g}) Hz and ({next_low:g}, {next_high:g}) Hz overlap: "
                f"{next_low:g} Hz lies in both (ends are inside)"
            )
