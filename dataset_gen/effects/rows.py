"""Rows that are read one after another, as a few bands of them, each at the time of its middle.

`time` of a picture is that of its middle row. Sixteen bands are off by a fiftieth of a readout, rms.
"""

from itertools import pairwise

import numpy as np

BANDS = 16


def bands(size: int, readout_s: float) -> list[tuple[slice, float]]:
    """Rows from top to bottom, and by how many seconds they are read after the middle row."""
    edges = np.linspace(0, size, min(BANDS, size) + 1).astype(int).tolist()
    return [(slice(a, b), readout_s * ((a + b) / 2 / size - 0.5)) for a, b in pairwise(edges)]


def row_delays(size: int, readout_s: float) -> np.ndarray:
    """[size] seconds after the middle row."""
    return np.asarray(readout_s * ((np.arange(size) + 0.5) / size - 0.5))
