"""One-third-octave spectra: the rms of a channel in the bands of IEC 61260-1, each with its standard deviation.

Bands are those of base 10: midbands 1000 · 10^(n/10) Hz, edges 10^(±1/20) from them. The power in a band is the sum of
the periodogram of the whole record (Hann window) between its edges, less what the channel's white noise of deviation σ
adds, 2σ²/rate a hertz. Noise n beside a signal s in one frequency scatters its power by √(2sn + n²); a Hann window
correlates neighbouring frequencies, so that the variance of a sum is 1.5 times that.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import periodogram

from tg4mm.show.analyse.channel import ORDER, Channel, unit_of
from tg4mm.show.analyse.quantities import Value, root_deviation

_NARROWEST = 2.0  # frequencies of the periodogram, 1 / duration apart: the width of the lowest band
_CORRELATED = 1.5  # equivalent noise bandwidth of the Hann window, in frequencies


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

    quantity: the channel's, or a derivative or integral of it: displacement, velocity, acceleration.
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
        yield ThirdOctave(
            channel.name, quantity, unit_of(quantity, channel.base), float(middle), (low, high), value
        )
