"""The choice of a draw mode for a file, and the detection of outliers that cost precision."""

from typing import Any

import numpy as np

from .. import names
from .points import values
from .shapes import DRAW_MODES, available

AUTOMATIC = "Automatic"
FRAME_NS = 1e9 / 24  # of a picture in playback
# Nanoseconds that a Gaussian takes to be evaluated, and more for each mode: docs/blender.md.
EVALUATED_NS, MODE_NS = 70.0, 8.0
OPAQUE = 0.3  # what is fainter may lie far off and counts for no size
ENDS = (1.0, 99.0)  # percentiles along each axis
MOST = 20_000  # points for a percentile
# EEVEE and Workbench keep a position of Blender's own splats in 22 bits of the extent: a step is that part of it. It is
# to be below a tenth of a pixel where what is opaque fills 2,048 pixels.
FARTHEST = 0.1 * 2**22 / 2048


def best(count: int, n_modes: int) -> str:
    """Return the best draw mode that a laptop plays at 24 frames per second with `count` moving Gaussians."""
    here = available(moves=n_modes > 0)
    if own := [name for name, mode in here.items() if mode.native]:
        return own[0]
    costs = {name: mode.drawn_ns for name, mode in here.items() if mode.drawn_ns is not None}
    left = FRAME_NS / max(count, 1) - EVALUATED_NS - n_modes * MODE_NS
    return max(
        (name for name in costs if costs[name] <= left),
        key=lambda name: (here[name].soft, costs[name]),
        default=min(costs, key=costs.__getitem__),
    )


def least_opacity(draw: str) -> str:
    """Return the input that sets the lowest opacity drawn in this mode."""
    return names.MIN_SPLAT_OPACITY if DRAW_MODES[draw].soft else names.MIN_OPACITY


def main_points(mesh: Any) -> np.ndarray:
    """[n, 3] float64 positions of the opaque Gaussians, evenly picked of many; all where none is opaque."""
    places, solid = values(mesh, "position"), np.flatnonzero(values(mesh, names.OPACITY) >= OPAQUE)
    chosen = solid if len(solid) else np.arange(len(places))
    return places[chosen[:: max(1, len(chosen) // MOST)]].astype(np.float64)


def outliers(mesh: Any) -> np.ndarray:
    """[N] bool: Gaussians so far from the opaque ones that positions of all become coarse; none where they are not."""
    places = values(mesh, "position")
    middle, size, span = _extent(mesh, places)
    return (np.abs(places - middle).max(axis=1, initial=0.0) > FARTHEST / 2 * size) & (span > FARTHEST)


def far_out(mesh: Any) -> tuple[int, float]:
    """Return the number of outliers, and the total extent as a multiple of the size without them."""
    span = _extent(mesh, values(mesh, "position"))[2]
    return (int(outliers(mesh).sum()) if span > FARTHEST else 0), span


def _extent(mesh: Any, places: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Return the centre [3] and size (scene units) of opaque Gaussians, and the total extent in sizes."""
    if not len(places):
        return np.zeros(3), 1.0, 0.0
    low, high = np.percentile(main_points(mesh), ENDS, axis=0)
    size = float((high - low).max()) or 1.0
    return (low + high) / 2, size, max(float(np.ptp(axis)) for axis in places.T) / size
