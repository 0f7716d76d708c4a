"""The times that one picture shows: of rows read one after another, or of an exposure.

Rows are a few bands of them, each at the time of its middle; `time` of a picture is that of its middle row. Sixteen
bands are off by a fiftieth of a readout, rms. An exposure is the weighted mean of a few moments of it, around `time`
(Gauss–Legendre: exact to 1e-6 for an exposure of half a period).
"""

from itertools import pairwise

import numpy as np

BANDS = 16
MOMENTS = 5


def bands(size: int, readout_s: float) -> list[tuple[slice, float]]:
    """Rows from top to bottom, and by how many seconds they are read after the middle row."""
    edges = np.linspace(0, size, min(BANDS, size) + 1).astype(int).tolist()
    return [(slice(a, b), readout_s * ((a + b) / 2 / size - 0.5)) for a, b in pairwise(edges)]


def row_delays(size: int, readout_s: float) -> np.ndarray:
    """[size] seconds after the middle row."""
    return np.asarray(readout_s * ((np.arange(size) + 0.5) / size - 0.5))


def moments(shutter_s: float) -> list[tuple[float, float]]:
    """(share of the light, seconds after the middle) of the moments of an exposure; the shares sum to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(MOMENTS)
    return [(0.5 * w, 0.5 * shutter_s * x) for w, x in zip(weights.tolist(), nodes.tolist(), strict=True)]
