"""Averaged spectra: power spectral density by Welch's method with its confidence interval, and the waterfall."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import get_window, spectrogram, welch
from scipy.stats import chi2

from tg4mm.show.analyse.channel import AnalyseError, Channel
from tg4mm.show.options import AveragingOptions

_SEGMENTS = 9  # half segments in a record, where no length is given: eight averages
_SHORTEST = 8  # samples of a segment


@dataclass(frozen=True)
class Averaging(AveragingOptions):
    """How a record is cut into segments: window (scipy's name), seconds (None: eight averages), share of overlap."""

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


def density_of(channel: Channel, averaging: Averaging | None = None, confidence: float = 0.95) -> Density:
    """Return the power spectral density of a channel."""
    averaging = averaging or Averaging()
    length, shared = averaging.cut(channel)
    freqs, power = welch(channel.values, channel.rate, averaging.window, length, shared)
    freedom = averaging.freedom(channel)
    tail = (1 - confidence) / 2
    low, high = freedom / chi2.isf(tail, freedom), freedom / chi2.ppf(tail, freedom)
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
