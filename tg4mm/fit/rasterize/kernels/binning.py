"""Binning of Gaussians to tiles: depth order, exact ellipse-tile overlap, one list per tile.

Everything is a stable counting sort over fixed chunks, so the lists do not depend on the number of threads. Tile
extents are found sixteen Gaussians at a time, a lane each, by row of tiles: an ellipse cut by a band of pixels is
convex, so its extent in x is taken either at its own extreme point or at the nearer edge of the band: exact, no
bounding box.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import float32, int64, uint32

from tg4mm.core.memory import Buffers
from tg4mm.fit.rasterize.kernels.block_culling import prefetch_gaussians
from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel, shared
from tg4mm.fit.rasterize.kernels.layout import CC, DEPTH, EX, EY, MX, POWER, SPLAT_WIDTH, SQUARES, TILE
from tg4mm.fit.rasterize.simd import functions  # noqa: F401, roots of vectors and whole numbers near them
from tg4mm.fit.rasterize.simd.memory import address, keep, load, number, prefetch_row, store
from tg4mm.fit.rasterize.simd.rows import columns, row_starts
from tg4mm.fit.rasterize.simd.vector import LANES, broadcast, first_lanes, movemask, select

_STARTS, _FIRST_ROW, _LAST_ROW, _SPANS = 0, LANES, 2 * LANES, 3 * LANES  # places in the room
_RADIX_BITS = 11
_CHUNKS = 16  # of the parallel scatter; a constant, so that results never depend on threads
_PREFETCH = 8  # Gaussians prefetched ahead of their use: in depth order they lie anywhere in memory
_PAIRS_EXPECTED = 4  # tiles a Gaussian; where there are more, the lists are made a second time


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


@kernel
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


@kernel
def depth_order(splats, keys, order, keys2, order2):
    """Indices of the visible Gaussians by increasing depth, stable, in `order2`. Returns their number.

    Least-significant-digit radix sort of the bits of a positive float, which order as the floats do.
    """
    bits = splats[:, DEPTH].copy().view(np.uint32)
    n = int64(0)
    for i in range(splats.shape[0]):
        if splats[i, POWER] > float32(0.0):
            keys[n] = bits[i]
            order[n] = i
            n += 1
    # for each literal a pass would be compiled anew
    digit, size = int64(_RADIX_BITS), int64(1 << _RADIX_BITS)
    _radix_pass(keys, order, keys2, order2, n, int64(0), size)
    _radix_pass(keys2, order2, keys, order, n, digit, size)
    _radix_pass(keys, order, keys2, order2, n, 2 * digit, size)
    return n


@shared
def list_pairs(worker, workers, splats, order, n_visible, n_x, n_y, tiles, gaussian_start, per_chunk, needed):
    """The tiles of every Gaussian in depth order, chunk by chunk, and how many pairs a chunk gives each tile.

    `tiles` [chunks, capacity]: what does not fit is counted in `needed` [chunks] but not written, and the caller
    comes again with more room. `gaussian_start` [k + 1] gets the end of Gaussian k's pairs within its chunk.
    """
    size = (n_visible + _CHUNKS - 1) // _CHUNKS
    room = tiles.shape[1]
    for chunk in range(worker, _CHUNKS, workers):
        count = per_chunk[chunk]
        count[:] = 0
        spans = np.empty(extents_room(n_y), np.float32)
        room_of_spans, total, end = address(spans), int64(0), min(n_visible, (int64(chunk) + 1) * size)
        for k in range(int64(chunk) * size, end, LANES):
            some = min(end - k, int64(LANES))
            prefetch_gaussians(address(splats), address(order), k + LANES, LANES, end)
            tile_extents(address(splats), address(order), k, some, n_x, n_y, room_of_spans)
            for lane in range(some):
                first_row, last_row = tile_rows(room_of_spans, lane)
                for ty in range(first_row, last_row + 1):
                    first, last = tiles_of_row(room_of_spans, lane, ty - first_row)
                    for tile in range(ty * n_x + first, ty * n_x + last + 1):
                        count[tile] += 1
                        if total < room:
                            tiles[chunk, total] = tile
                        total += 1
                gaussian_start[k + lane + 1] = total
        keep(spans)
        needed[chunk] = total


@kernel
def offsets(per_chunk, tile_start):
    """Turn counts into start positions: `tile_start` [tiles + 1], and in place those of each chunk's pairs."""
    n_chunks, n_tiles = per_chunk.shape
    tile_start[:] = 0
    for chunk in range(n_chunks):
        for tile in range(n_tiles):
            before = tile_start[tile + 1]
            tile_start[tile + 1] = before + per_chunk[chunk, tile]
            per_chunk[chunk, tile] = before
    for tile in range(n_tiles):
        tile_start[tile + 1] += tile_start[tile]
    for chunk in range(n_chunks):
        for tile in range(n_tiles):
            per_chunk[chunk, tile] += tile_start[tile]


@shared
def fill_pairs(
    worker, workers, order, n_visible, tiles, needed, per_chunk, gaussian_start, pair_gaussian, pair_slot
):
    """Write each tile's Gaussians in depth order, and for each Gaussian where its pairs went."""
    size = (n_visible + _CHUNKS - 1) // _CHUNKS
    gaussian_start[0] = 0
    for chunk in range(worker, _CHUNKS, workers):
        taken = per_chunk[chunk]
        base = int64(0)
        for c in range(chunk):
            base += needed[c]
        n = int64(0)
        for k in range(chunk * size, min(n_visible, (chunk + 1) * size)):
            i = order[k]
            end = gaussian_start[k + 1]
            gaussian_start[k + 1] = base + end
            for m in range(n, end):
                tile = tiles[chunk, m]
                place = taken[tile]
                taken[tile] = place + 1
                pair_gaussian[place] = i
                pair_slot[base + m] = place
            n = end


@shared
def gather_sums(worker, workers, order, n_visible, gaussian_start, pair_slot, pair_sums, v_splats):
    """Add up the `pair_sums` [P, SPLAT_WIDTH] of each visible Gaussian, in a fixed order, to its row of `v_splats`."""
    last = len(pair_slot) - 1
    pairs, sums = pair_sums.reshape(-1), v_splats.reshape(-1)
    for k in range(worker * n_visible // workers, (worker + 1) * n_visible // workers):
        i = order[k]
        prefetch_row(v_splats, int64(order[min(k + _PREFETCH, n_visible - 1)]))
        total = broadcast(float32(0.0))
        for slot in range(gaussian_start[k], gaussian_start[k + 1]):
            prefetch_row(pair_sums, int64(pair_slot[min(slot + 3 * _PREFETCH, last)]))
            total = total + load(pairs, int64(pair_slot[slot]) * SPLAT_WIDTH)
        store(sums, int64(i) * SPLAT_WIDTH, total)


@dataclass
class Bins:
    """Tile lists of one view: what `bin_splats` returns and blending reads."""

    order: np.ndarray  # [n_visible] Gaussians by depth
    n_visible: int
    tile_start: np.ndarray  # [tiles + 1]
    gaussian_start: np.ndarray  # [n_visible + 1]
    pair_gaussian: np.ndarray  # [P] int32, Gaussian of each pair, tile by tile, near to far
    pair_slot: np.ndarray  # [P] int32, positions of each Gaussian's pairs
    reached: np.ndarray  # [P] uint32, blocks of the tile in which a pair is seen; blend_forward writes it


def bin_splats(splats: np.ndarray, width: int, height: int, buffers: Buffers | None = None) -> Bins:
    """Sort and distribute the projected Gaussians `splats` [N, SPLAT_WIDTH] to tiles of the image.

    With `buffers` the lists lie there, and hold until the next call with the same ones.
    """
    n, buffers = splats.shape[0], buffers or Buffers()
    n_x, n_y = -(-width // TILE), -(-height // TILE)
    keys, keys2 = (buffers.take(name, (n,), np.uint32) for name in ("keys", "keys2"))
    scratch, order = (buffers.take(name, (n,), np.int32) for name in ("scratch", "order"))
    n_visible = depth_order(splats, keys, scratch, keys2, order)
    per_chunk, needed = (
        buffers.take("per_chunk", (_CHUNKS, n_x * n_y), np.int32),
        np.empty(_CHUNKS, np.int64),
    )
    gaussian_start = buffers.take("gaussian_start", (n_visible + 1,), np.int32)
    room = _PAIRS_EXPECTED * (n_visible // _CHUNKS + 1)
    while True:
        tiles = buffers.take("tiles", (_CHUNKS, room), np.int32)
        list_pairs(splats, order, n_visible, n_x, n_y, tiles, gaussian_start, per_chunk, needed)
        if needed.max() <= room:
            break
        room = int(needed.max())
    n_pairs = int(needed.sum())
    tile_start = buffers.take("tile_start", (n_x * n_y + 1,), np.int32)
    offsets(per_chunk, tile_start)
    pair_gaussian, pair_slot = (
        buffers.take(name, (n_pairs,), np.int32) for name in ("pair_gaussian", "pair_slot")
    )
    fill_pairs(order, n_visible, tiles, needed, per_chunk, gaussian_start, pair_gaussian, pair_slot)
    reached = buffers.take("reached", (n_pairs,), np.uint32)
    return Bins(order, n_visible, tile_start, gaussian_start, pair_gaussian, pair_slot, reached)


def seen(bins: Bins) -> Bins:
    """The lists without pairs of which nothing is seen, and without Gaussians that have no others.

    For lists that are gone through many times; after `blend_forward` has written `bins.reached`.
    """
    keep = bins.reached != 0
    before = np.concatenate([[0], np.cumsum(keep)]).astype(np.int32)
    in_slots = keep[bins.pair_slot]
    start = np.concatenate([[0], np.cumsum(in_slots)]).astype(np.int32)[bins.gaussian_start]
    has_some = np.diff(start) > 0
    return Bins(
        order=bins.order[: bins.n_visible][has_some],
        n_visible=int(has_some.sum()),
        tile_start=before[bins.tile_start],
        gaussian_start=np.append(start[:-1][has_some], start[-1]),
        pair_gaussian=bins.pair_gaussian[keep],
        pair_slot=before[bins.pair_slot[in_slots]],
        reached=bins.reached[keep],
    )
