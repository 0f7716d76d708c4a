"""Times of a picture's rows with a rolling shutter, relative to that of the frame, which is its middle row's."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

BANDS = 64  # of a picture: near half the frame rate phases inside one differ by 1.4° at most, if a readout is a frame


def row_delays(readout_s: float, rows: ArrayLike, height: int) -> np.ndarray:
    """Return the seconds after the frame's time at which rows, from 0, of a picture `height` rows high are read."""
    return np.asarray(readout_s * ((np.asarray(rows) + 0.5) / height - 0.5))


@dataclass(frozen=True)
class Band:
    """Rows that count as read at one time."""

    rows: slice
    delay_s: float  # after the time of the frame


def bands_of(readout_s: float, height: int) -> list[Band]:
    """Return the bands of a picture of so many rows, from top to bottom; one if all rows are read at once."""
    if not readout_s:
        return [Band(slice(0, height), 0.0)]
    edges = np.linspace(0, height, min(BANDS, height) + 1).astype(int)
    return [
        Band(slice(int(a), int(b)), float(row_delays(readout_s, (a + b - 1) / 2, height)))
        for a, b in pairwise(edges)
    ]
