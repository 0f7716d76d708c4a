"""Tile extents of Gaussians: which tiles an ellipse reaches, by row of tiles; sixteen at a time, a lane a Gaussian.

An ellipse cut by a band of pixels is convex, so its extent in x is taken either at its own extreme point or at the
nearer edge of the band: exact, no bounding box.
"""

# mypy: disable-error-code="call-arg, arg-type, call-overload, operator, var-annotated"
# an intrinsic has one argument more than its calls: the typing context; and vectors look like nothing mypy knows

import math

from numba import float32, int64

from tg4mm.fit.rasterize.kernels.compiled import inlined
from tg4mm.fit.rasterize.kernels.layout import CC, EX, EY, MX, SQUARES, TILE
from tg4mm.fit.rasterize.simd import functions  # noqa: F401, roots of vectors and whole numbers near them
from tg4mm.fit.rasterize.simd.masks import first_lanes
from tg4mm.fit.rasterize.simd.memory import number, store
from tg4mm.fit.rasterize.simd.rows import columns, row_starts
from tg4mm.fit.rasterize.simd.vector import LANES, broadcast, movemask, select

_STARTS, _FIRST_ROW, _LAST_ROW, _SPANS = 0, LANES, 2 * LANES, 3 * LANES  # places in the room


@inlined
def extents_room(n_y):
    """float32 that sixteen Gaussians need in a picture of n_y rows of tiles."""
    return _SPANS + 2 * LANES * n_y


@inlined
def _tiles(low, high, n):
    """Tiles [first, last] of n in a line that have a pixel in low … high, measured from the first pixel's centre."""
    each = float32(1.0 / TILE)
    first = math.ceil(min(max((low - float32(TILE - 1)) * each, float32(0.0)), float32(n)))
    return first, math.floor(min(max(high * each, float32(-1.0)), float32(n - 1)))


@inlined
def tile_extents(splats, order, k, count, n_x, n_y, room):
    """Write, for the Gaussians at k … k + count - 1, at most 16, in `order`: the tiles they reach, to `room`.

    splats, order, room: addresses. For `tile_rows` and `tiles_of_row`.
    """
    zero, half = float32(0.0), float32(0.5)
    store(room, int64(_STARTS), row_starts(order, k, count))
    starts = room + 4 * _STARTS
    mx, my, _, cb = columns(splats, starts, int64(MX))
    cc, _, _, _ = columns(splats, starts, int64(CC))
    ey, ex, power, r11 = columns(splats, starts, int64(EY))
    _, _, _, l22 = columns(splats, starts, int64(EX))
    tangent = -cb / cc * ex  # dy of the rightmost point; the leftmost is its mirror
    limit = float32(2.0 * SQUARES) * power
    slope = float32(-SQUARES) * cb * r11 * r11
    x, y = mx - half, my - half  # pixel i has its centre at i + 0.5
    first_row, last_row = _tiles(y - ey, y + ey, n_y)
    last_row = first_lanes(last_row, count, float32(-1.0))
    store(room, int64(_FIRST_ROW), first_row)
    store(room, int64(_LAST_ROW), last_row)
    row, place = first_row, int64(_SPANS)
    while movemask(last_row >= row) != 0:
        top = row * float32(TILE) + half - my
        low, high = max(top, -ey), min(top + float32(TILE - 1), ey)
        right_y, left_y = min(max(tangent, low), high), min(max(-tangent, low), high)
        right_q, left_q = l22 * right_y, l22 * left_y
        right = x + slope * right_y + r11 * math.sqrt(max(limit - right_q * right_q, zero))
        left = x + slope * left_y - r11 * math.sqrt(max(limit - left_q * left_q, zero))
        first, last = _tiles(left, right, n_x)
        store(room, place, first)
        store(room, place + LANES, select(high >= low, last, broadcast(float32(-1.0))))
        row, place = row + float32(1.0), place + 2 * LANES


@inlined
def tile_rows(room, lane):
    """Rows of tiles [first, last] that the lane-th of the Gaussians reaches."""
    return int64(number(room, _FIRST_ROW + lane)), int64(number(room, _LAST_ROW + lane))


@inlined
def tiles_of_row(room, lane, r):
    """Tiles [first, last] in the r-th of these rows."""
    place = _SPANS + 2 * LANES * r + lane
    return int64(number(room, place)), int64(number(room, place + LANES))
