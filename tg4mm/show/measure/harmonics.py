"""Peaks that may be harmonics: where pictures do not change in proportion to motion, f makes peaks at 2f and 3f too."""

from collections.abc import Sequence
from dataclasses import dataclass

_ORDERS = 2, 3
NEAR = 0.5  # of 1 / duration
SURE = 3.0  # deviations


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
    """For each of several peaks, the strongest peak that it may be a harmonic of; None where there is none.

    hz and deviation of the frequencies, size: amplitudes; resolution: 1 / duration, Hz. What lies above half the frame
    rate is looked for where it appears in the record.
    """

    def of(k: int) -> Harmonic | None:
        for j in sorted(range(len(hz)), key=lambda j: -size[j]):
            for order in _ORDERS if size[j] > size[k] else ():
                error = SURE * (deviation[k] ** 2 + (order * deviation[j]) ** 2) ** 0.5
                is_told = SURE * deviation[j] < resolution  # else many a peak would be near
                if is_told and abs(seen_at(order * hz[j], fps) - hz[k]) < max(NEAR * resolution, error):
                    return Harmonic(order, hz[j])
        return None

    return [of(k) for k in range(len(hz))]


def seen_at(hz: float, fps: float) -> float:
    """Where a frequency appears in samples taken at `fps` Hz."""
    return abs(hz - round(hz / fps) * fps)
