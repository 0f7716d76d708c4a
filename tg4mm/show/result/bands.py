"""The band to magnify around each frequency that was found."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tg4mm.show.result.model import Band

_DEVIATIONS = 3.0


def suggested_bands(
    hz: Sequence[float],
    deviations_hz: Sequence[float],
    duration_s: float,
    fps: float,
    reach_hz: Sequence[float] | None = None,
) -> list[Band]:
    """A band for each of the frequencies [K], in their order, which does not hold another one of them.

    One step of the record's resolution, 1 / duration, to either side, since that is how far a sinusoid's bins reach;
    `reach_hz` where that is more, of lines that are wide since they ring down; and more where the frequency is known
    to less than a third of it. It ends half-way to the next frequency, above 0 Hz and
    below half the frame rate, and its ends are round numbers.
    """
    out = []
    for f, deviation, reach in zip(hz, deviations_hz, reach_hz or [0.0] * len(hz), strict=True):
        half = max(1 / duration_s, reach, _DEVIATIONS * deviation)
        low = max([f - half, 0.5 / duration_s, *((f + other) / 2 for other in hz if other < f)])
        high = min([f + half, 0.999 * fps / 2, *((f + other) / 2 for other in hz if other > f)])
        out.append(_rounded(low, high, f))
    return out


def _rounded(low: float, high: float, f: float) -> Band:
    """Ends with as few digits as a twentieth of the band allows, moved inwards, the frequency still inside."""
    digits = max(0, math.ceil(-math.log10((high - low) / 20)))
    scale = 10.0**digits
    inner = math.ceil(round(low * scale, 6)) / scale, math.floor(round(high * scale, 6)) / scale
    return inner if inner[0] < f < inner[1] else (low, high)
