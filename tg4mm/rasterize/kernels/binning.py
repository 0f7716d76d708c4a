"""Which tile sees which Gaussian: depth order, exact ellipse-tile overlap, one list per tile.

Everything is a stable counting sort over fixed chunks, so the lists do not depend on the number of threads.
"""

import math

import numpy as np
from numba import float32, int32, int64, njit, prange, uint32

from tg4mm.rasterize.kernels.layout import CA, CB, CC, DEPTH, EX, EY, MX, MY, POWER, TILE

_RADIX_BITS = 11
_CHUNKS = 16  # of the parallel scatter; a constant, so that results never depend on threads


@njit(cache=True)
def _radix_pass(keys, order, keys_out, order_out, n, shift, size):
    """One stable counting pass over the digit of `keys` at bit `shift`."""
    count = np.zeros(size + 1, np.int64)
    mask, shift = uint32(size - 1), uint32(shift)
    for i in range(n):
        count[int64((keys[i] >> shift) & mask) + 1] += 1
    for d in range(size):
        count[d + 1] += count[d]
    for i in range(n):
        d = int64((keys[i] >> shift) & mask)
        place = count[d]
        keys_out[place] = keys[i]
        order_out[place] = order[i]
        count[d] = place + 1


@njit(cache=True)
def depth_order(splats, keys, order, keys2, order2):
    """Indices of the visible Gaussians by increasing depth, stable, in `order2`. Returns their number.

    Least-significant-digit radix sort of the bits of a positive float, which order as the floats do.
    """
    bits = splats[:, DEPTH].copy().view(np.uint32)
    n = 0
    for i in range(splats.shape[0]):
        if splats[i, POWER] > float32(0.0):
            keys[n] = bits[i]
            order[n] = i
            n += 1
    size = 1 << _RADIX_BITS
    _radix_pass(keys, order, keys2, order2, n, 0, size)
    _radix_pass(keys2, order2, keys, order, n, _RADIX_BITS, size)
    _radix_pass(keys, order, keys2, order2, n, 2 * _RADIX_BITS, size)
    return n


@njit(fastmath=True, inline="always")
def _row_interval(splats, i, y0, y1, n_x):
    """Tiles [first, last] in the tile row with pixel centres y0 … y1 that the ellipse of Gaussian i reaches.

    The ellipse cut by a band is convex, so its extent in x is taken either at its own extreme point or at the
    nearer edge of the band: exact, no bounding box.
    """
    a, b, c = splats[i, CA], splats[i, CB], splats[i, CC]
    reach = splats[i, EY]
    lo, hi = max(y0 - splats[i, MY], -reach), min(y1 - splats[i, MY], reach)
    if lo > hi:
        return int64(1), int64(0)
    tangent = -b / c * splats[i, EX]  # dy of the rightmost point; the leftmost is its mirror
    right_y = min(max(tangent, lo), hi)
    left_y = min(max(-tangent, lo), hi)
    # half the chord at height y is `widest` √(1 - (y / reach)²)
    one, widest = float32(1.0), math.sqrt(float32(2.0) * splats[i, POWER] / a)
    right_h, left_h = right_y / reach, left_y / reach
    right = -b / a * right_y + widest * math.sqrt(max(one - right_h * right_h, float32(0.0)))
    left = -b / a * left_y - widest * math.sqrt(max(one - left_h * left_h, float32(0.0)))
    x = splats[i, MX] - float32(0.5)  # pixel i has its centre at i + 0.5
    first = int64(math.ceil((x + left - float32(TILE - 1)) / float32(TILE)))
    last = int64(math.floor((x + right) / float32(TILE)))
    return max(first, int64(0)), min(last, int64(n_x - 1))


@njit(fastmath=True, inline="always")
def _tile_rows(splats, i, n_y):
    """Tile rows [first, last] that the ellipse of Gaussian i reaches."""
    reach = splats[i, EY]
    y = splats[i, MY] - float32(0.5)
    first = int64(math.ceil((y - reach - float32(TILE - 1)) / float32(TILE)))
    last = int64(math.floor((y + reach) / float32(TILE)))
    return max(first, int64(0)), min(last, int64(n_y - 1))


@njit(parallel=True, cache=True)
def count_pairs(splats, order, n_visible, n_x, n_y, per_chunk, per_gaussian):
    """Number of pairs per (chunk, tile) and per Gaussian of the depth order. Both arrays are overwritten."""
    size = (n_visible + _CHUNKS - 1) // _CHUNKS
    for chunk in prange(_CHUNKS):
        for tile in range(n_x * n_y):
            per_chunk[chunk, tile] = 0
        for k in range(chunk * size, min(n_visible, (chunk + 1) * size)):
            i = order[k]
            total = 0
            first_row, last_row = _tile_rows(splats, i, n_y)
            for ty in range(first_row, last_row + 1):
                y0 = float32(ty * TILE) + float32(0.5)
                first, last = _row_interval(splats, i, y0, y0 + float32(TILE - 1), n_x)
                for tx in range(first, last + 1):
                    per_chunk[chunk, ty * n_x + tx] += 1
                    total += 1
            per_gaussian[k] = total


@njit(cache=True)
def offsets(per_chunk, per_gaussian, n_visible, tile_start, gaussian_start):
    """Turn counts into start positions, in place for `per_chunk`. Returns the number of pairs."""
    total = 0
    for tile in range(per_chunk.shape[1]):
        tile_start[tile] = total
        for chunk in range(per_chunk.shape[0]):
            c = per_chunk[chunk, tile]
            per_chunk[chunk, tile] = total
            total += c
    tile_start[per_chunk.shape[1]] = total
    running = 0
    for k in range(n_visible):
        gaussian_start[k] = running
        running += per_gaussian[k]
    gaussian_start[n_visible] = running
    return total


@njit(parallel=True, cache=True)
def fill_pairs(splats, order, n_visible, n_x, n_y, per_chunk, gaussian_start, pair_gaussian, pair_slot):
    """Write each tile's Gaussians in depth order, and for each Gaussian where its pairs went."""
    size = (n_visible + _CHUNKS - 1) // _CHUNKS
    for chunk in prange(_CHUNKS):
        for k in range(chunk * size, min(n_visible, (chunk + 1) * size)):
            i = order[k]
            slot = gaussian_start[k]
            first_row, last_row = _tile_rows(splats, i, n_y)
            for ty in range(first_row, last_row + 1):
                y0 = float32(ty * TILE) + float32(0.5)
                first, last = _row_interval(splats, i, y0, y0 + float32(TILE - 1), n_x)
                for tx in range(first, last + 1):
                    place = per_chunk[chunk, ty * n_x + tx]
                    per_chunk[chunk, ty * n_x + tx] = place + 1
                    pair_gaussian[place] = int32(i)
                    pair_slot[slot] = int32(place)
                    slot += 1


@njit(parallel=True, fastmath=True, cache=True)
def gather_gradient(order, n_visible, gaussian_start, pair_slot, v_pairs, v_splats):
    """Sum the gradients of a Gaussian's pairs, in a fixed order; `v_splats` is written where visible."""
    for k in prange(n_visible):
        i = order[k]
        for c in range(v_splats.shape[1]):
            v_splats[i, c] = float32(0.0)
        for slot in range(gaussian_start[k], gaussian_start[k + 1]):
            place = pair_slot[slot]
            for c in range(v_pairs.shape[1]):
                v_splats[i, c] += v_pairs[place, c]


class Bins:
    """Tile lists of one view: what `bin_splats` returns and blending reads."""

    def __init__(self, order, n_visible, tile_start, gaussian_start, pair_gaussian, pair_slot):
        self.order = order  # [n_visible] Gaussians by depth
        self.n_visible = n_visible
        self.tile_start = tile_start  # [tiles + 1]
        self.gaussian_start = gaussian_start  # [n_visible + 1]
        self.pair_gaussian = pair_gaussian  # [P] int32, Gaussian of each pair, tile by tile, near to far
        self.pair_slot = pair_slot  # [P] int32, positions of each Gaussian's pairs


def bin_splats(splats: np.ndarray, width: int, height: int) -> Bins:
    """Sort and distribute the projected Gaussians `splats` [N, SPLAT_WIDTH] to tiles of the image."""
    n = splats.shape[0]
    n_x, n_y = -(-width // TILE), -(-height // TILE)
    keys, keys2 = np.empty(n, np.uint32), np.empty(n, np.uint32)
    scratch, order = np.empty(n, np.int32), np.empty(n, np.int32)
    n_visible = depth_order(splats, keys, scratch, keys2, order)
    per_chunk = np.empty((_CHUNKS, n_x * n_y), np.int64)
    per_gaussian = np.empty(n_visible, np.int64)
    count_pairs(splats, order, n_visible, n_x, n_y, per_chunk, per_gaussian)
    tile_start, gaussian_start = np.empty(n_x * n_y + 1, np.int64), np.empty(n_visible + 1, np.int64)
    n_pairs = offsets(per_chunk, per_gaussian, n_visible, tile_start, gaussian_start)
    pair_gaussian, pair_slot = np.empty(n_pairs, np.int32), np.empty(n_pairs, np.int32)
    fill_pairs(splats, order, n_visible, n_x, n_y, per_chunk, gaussian_start, pair_gaussian, pair_slot)
    return Bins(order, n_visible, tile_start, gaussian_start, pair_gaussian, pair_slot)
