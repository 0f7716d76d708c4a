"""Bands of a picture's rows, each taken as read at one time (rolling shutter)."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

BANDS = 64  # of a picture: near half the frame rate phases inside one differ by 1.4° at most, if a readout is a frame


@dataclass(frozen=True)
class Band:
    """Rows that count as read at one time."""

    rows: slice
    delay_s: float  # after the time of the frame, which is that of its middle row


def bands_of(readout_s: float, height: int) -> list[Band]:
    """Return the bands of a picture of so many rows, from top to bottom; one where all rows are read at once."""
    if not readout_s:
        return [Band(slice(0, height), 0.0)]
    edges = np.linspace(0, height, min(BANDS, height) + 1).astype(int)
    return [Band(slice(int(a), int(b)), readout_s * ((a + b) / 2 / height - 0.5)) for a, b in pairwise(edges)]
