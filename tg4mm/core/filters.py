"""Temporal band-pass filters by their frequency response, applied on the DFT bins of T timesteps.

`zero-phase`: a Hamming-windowed FIR of odd length about its centre tap; its response is real, so what comes out is
neither late nor early. `ideal`: 1 inside the band, 0 outside. `published`: the FIR of even length N of [TG4MM] and
[3DMM], put through `ifftshift` and the FFT. It has no centre tap, so the result is half a sample early: 18° at 3 Hz and
30° at 5 Hz with fps 30, a motion that is 31 % and 52 % off (2 sin(θ/2)), which α then multiplies.

Filtering over T timesteps takes the series as periodic, as the FFT does; a response is a function of frequency, so T
need not be the filter's length. Shorter than the filter, the series wraps around within it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tg4mm.core.choices import FILTERS
from tg4mm.core.errors import Tg4mmError

_AT_ONCE = 1 << 16  # series filtered at a time, bounds the memory of the spectra


@dataclass(frozen=True)
class TemporalFilter:
    """A temporal filter and its length. taps 0: one second of the capture, as in [TG4MM] (odd for `zero-phase`)."""

    kind: str = "zero-phase"
    taps: int = 0

    def checked(self) -> "TemporalFilter":
        """Itself. Raises Tg4mmError for an unknown kind, and a length of the wrong parity."""
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
        """[K] complex128: the factor that a component exp(+i 2π f t / fps) of each frequency gets.

        band (low, high) in Hz, 0 ≤ low < high < fps/2; low 0 makes it a low-pass, which keeps 0 Hz.
        """
        freqs = np.asarray(freqs_hz, np.float64)
        if self.kind == "ideal":
            return ((freqs >= band[0]) & (freqs <= band[1])).astype(np.complex128)
        taps, lags = fir(band, self.length(fps), fps)
        return np.exp(-2j * np.pi * np.outer(freqs, lags) / fps) @ taps


def fir(band: tuple[float, float], length: int, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """(taps [N], their lags [N] in samples) of a Hamming-windowed FIR; gain 1 at the band's centre.

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
    """[T // 2 + 1] frequencies in Hz of the DFT bins of T timesteps."""
    return np.fft.rfftfreq(n_timesteps, 1 / fps)
