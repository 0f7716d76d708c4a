"""Front-to-back compositing of the tile lists, [3DGS] Eq. (3). Blocks, tiles and threads as in `tiles.py`.

Pairs are taken a batch at a time, and within a batch the blocks one after the other: what a block's pixels have
gathered stays in registers while all of the batch's Gaussians that reach it are added.

Writes to memory outside the caches are slow, and few can be in flight at a time. So pixels are prefetched
(`prefetch_pixels` of `tiles.py`), and tiles that no Gaussian reaches are written a row here and there in between.
"""

import math

import numpy as np
from numba import float32, int64, uint32, uint64

from tg4mm.fit.rasterize.kernels.block_culling import (
    by_gaussian,
    fill_batch,
    log2_alpha,
    prefetch_gaussians,
    reaching,
    room,
    row_of,
)
from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel, shared
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MIN, FEAT, FEATURES, TILE
from tg4mm.fit.rasterize.kernels.tiles import (
    BLOCKS,
    TABLE,
    aligned,
    alphas,
    constants,
    corner,
    inside,
    pixel,
    prefetch_pairs,
    prefetch_pixels,
    work,
)
from tg4mm.fit.rasterize.simd.lanes import store_fours
from tg4mm.fit.rasterize.simd.memory import (
    address,
    fetch_add,
    integer,
    keep,
    load_pixels,
    number,
    put_integer,
    store,
)
from tg4mm.fit.rasterize.simd.rows import store_planes
from tg4mm.fit.rasterize.simd.vector import (
    PIXELS,
    broadcast_pixels,
    ctz,
    fma_where,
    movemask,
    not_empty,
    put_mask,
    select,
)

STRIDE = (2 + FEATURES) * PIXELS  # planes of a block: transmittance as it runs on, as it stopped, features
_WORD = 32
_BATCH = 2 * _WORD  # pairs, a bit each
# pairs of the next batch prefetched with each block of this one
_SHARE = _BATCH // BLOCKS
_ROOM = room(_BATCH)
# for every block, behind the two words of `by_block`: masks of the pixels that see a pair, a bit a pixel; in bytes
_MASKS = 4 * 2 * BLOCKS
_OF_BLOCK = _BATCH * PIXELS // 8


@inlined
def begin_blocks(state, nothing):
    """Reset the state. nothing: a vector of zeros and one of ones, in registers."""
    zero, one = nothing
    for k in range(BLOCKS):
        place = int64(k * STRIDE)
        store(state, place, one)
        store(state, place + PIXELS, one)
        for c in range(FEATURES):
            store(state, place + (2 + c) * PIXELS, zero)


@inlined
def write_tile(state, x0, y0, frame, image, transmittance):
    """Write a tile's state to the picture [H · W · FEATURES] and the transmittance [H · W]."""
    width, height = frame
    rows, columns = min(TILE, height - y0), min(TILE, width - x0)
    if rows == TILE and columns == TILE:
        step = int64(width * FEATURES)
        for k in range(BLOCKS):
            place, at = k * STRIDE, corner(k, x0, y0, width)
            store_fours(transmittance, at, int64(width), load_pixels(state, place + PIXELS))
            planes = (
                load_pixels(state, place + 2 * PIXELS), load_pixels(state, place + 3 * PIXELS),
                load_pixels(state, place + 4 * PIXELS), load_pixels(state, place + 5 * PIXELS),
            )  # fmt: skip
            store_planes(image, at * FEATURES, step, planes)
        return
    for r in range(rows):
        for j in range(columns):
            at, to = pixel(r, j, STRIDE), (y0 + r) * width + x0 + j
            transmittance[to] = number(state, PIXELS + at)
            for k in range(FEATURES):
                image[to * FEATURES + k] = number(state, (2 + k) * PIXELS + at)


@inlined
def write_blank(first, last, rows, n_x, frame, nothing, image, transmittance):
    """Write the entries first … last - 1 of a list of rows, TILE pixels each, of tiles that no Gaussian reaches.

    rows: the list's address. An entry is y · n_x + column, y the row of pixels and column that of tiles.
    """
    width = frame[0]
    zero, one = nothing
    for n in range(first, last):
        row = integer(rows, n)
        x, y = int64(row % uint32(n_x)) * TILE, int64(row // uint32(n_x))
        at = int64(y * width + x)
        if x + TILE <= width:
            for c in range(TILE // PIXELS):
                store(transmittance, at + c * PIXELS, one)
            for c in range(TILE * FEATURES // PIXELS):
                store(image, at * FEATURES + c * PIXELS, zero)
        else:
            for to in range(at, at + width - x):
                transmittance[to] = float32(1.0)
                for c in range(FEATURES):
                    image[to * FEATURES + c] = float32(0.0)


@inlined
def _add(n, y, on, sums, batch, splats, held, faintest, masks, noted):
    """Add the n-th pair of a batch, y its log2 of alpha in a block: the pixels that still take light, and the sums.

    sums: transmittance, what it was when a pixel stopped, and features. noted: whether to note who sees the pair.
    """
    _, _, powers, alpha_max, t_min = held
    t, left, f0, f1, f2, f3 = sums
    alpha, _, seen = alphas(y, faintest, alpha_max, powers)
    # a pixel that stops here may give nothing, but counts
    if noted:
        put_mask(masks, n, (t > t_min) & seen)
    w = t * alpha
    t = t - w
    on = t > t_min
    left = select(on, t, left)
    features = row_of(batch, _BATCH, n) + FEAT
    f0 = fma_where(on, w, number(splats, features), f0)
    f1 = fma_where(on, w, number(splats, features + 1), f1)
    f2 = fma_where(on, w, number(splats, features + 2), f2)
    f3 = fma_where(on, w, number(splats, features + 3), f3)
    return on, (t, left, f0, f1, f2, f3)


@inlined
def _blend_block(k, splats, batch, by_block, held, faintest, state, noted):
    """Add the pairs of a batch that may reach block k, at least one. Does the block still take light?

    noted: whether to note in which pairs it is seen.

    A pair's exponents are calculated before the pair in front of it is added: a round of the loop is a chain of some
    60 cycles, of which the processor holds few at a time.

    The transmittance runs on where a pixel has stopped: it falls, so that nothing more is added. That way the next pair
    waits for no comparison. Nor does the loop end when no pixel is left: once for every block the processor would
    foresee it wrongly, which costs as much as the rest of a batch.
    """
    lane_y, t_min = held[1], held[4]
    place = k * STRIDE
    t, left = load_pixels(state, place), load_pixels(state, place + PIXELS)
    f0, f1 = load_pixels(state, place + 2 * PIXELS), load_pixels(state, place + 3 * PIXELS)
    f2, f3 = load_pixels(state, place + 4 * PIXELS), load_pixels(state, place + 5 * PIXELS)
    on, sums = t > t_min, (t, left, f0, f1, f2, f3)
    todo = uint64(integer(by_block, k)) | uint64(integer(by_block, BLOCKS + k)) << uint64(_WORD)
    masks = by_block + _MASKS + k * _OF_BLOCK
    n = ctz(todo)
    y = log2_alpha(batch, _BATCH, n, k, lane_y)
    todo &= todo - uint64(1)
    while todo != 0:
        later = ctz(todo)
        y_later = log2_alpha(batch, _BATCH, later, k, lane_y)
        todo &= todo - uint64(1)
        on, sums = _add(n, y, on, sums, batch, splats, held, faintest, masks, noted)
        n, y = later, y_later
    on, sums = _add(n, y, on, sums, batch, splats, held, faintest, masks, noted)
    t, left, f0, f1, f2, f3 = sums
    store(state, place, t)
    store(state, place + PIXELS, left)
    store(state, place + 2 * PIXELS, f0)
    store(state, place + 3 * PIXELS, f1)
    store(state, place + 4 * PIXELS, f2)
    store(state, place + 5 * PIXELS, f3)
    return movemask(on) != 0


@inlined
def _note_seen(by_block, count, reached):
    """Convert the pairs seen in each block to the blocks in which each pair is seen."""
    # Only now: what has just been written in small pieces cannot be read as a whole until it is in the cache.
    for k in range(BLOCKS):
        masks = by_block + _MASKS + k * _OF_BLOCK
        put_integer(by_block, k, integer(by_block, k) & not_empty(masks, int64(0)))
        put_integer(by_block, BLOCKS + k, integer(by_block, BLOCKS + k) & not_empty(masks, int64(_WORD)))
    for first in range(0, count, _WORD):
        by_gaussian(
            by_block + 4 * (first // _WORD) * BLOCKS, min(count - first, int64(_WORD)), reached + 4 * first
        )


@shared
def _forward(worker, workers, parts, counter, tables, frame, splats, image, transmittance, alpha_min):
    tile_start, pair_gaussian, table, reached = tables
    order, blank = parts
    width, height = frame
    n_x = (width + TILE - 1) // TILE
    faintest, noted = float32(math.log2(alpha_min)), len(reached) > 0
    held = constants(table)
    # as a constant of the code, zero is written in more and smaller pieces
    nothing = held[4] - held[4], broadcast_pixels(float32(1.0))
    memory = aligned(BLOCKS * STRIDE + _ROOM + (_MASKS + BLOCKS * _OF_BLOCK) // 4)
    state = address(memory)
    batch = state + 4 * BLOCKS * STRIDE
    by_block = batch + 4 * _ROOM
    splats, gaussians, seen_in, blank_rows = (
        address(splats),
        address(pair_gaussian),
        address(reached),
        address(blank),
    )
    image, transmittance = image.reshape(-1), transmittance.reshape(-1)
    # rows without Gaussians are shared out evenly among the pairs
    n_pairs, n_rows = int64(tile_start[len(tile_start) - 1]), int64(len(blank))
    if n_pairs == 0:
        first, last = worker * n_rows // workers, (worker + 1) * n_rows // workers
        write_blank(first, last, blank_rows, n_x, frame, nothing, image, transmittance)
    item = fetch_add(counter)
    while item < len(order):
        tile = order[item]
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        begin, end = int64(tile_start[tile]), int64(tile_start[tile + 1])
        later = order[min(item + workers, len(order) - 1)]
        prefetch_pairs(splats, gaussians, int64(tile_start[later]), int64(tile_start[later + 1]))
        prefetch_pixels(tile, n_x, frame, image, transmittance)
        begin_blocks(state, nothing)
        live = inside(min(TILE, height - y0), min(TILE, width - x0))
        first, row = begin, begin * n_rows // n_pairs
        while first < end and live != 0:
            last = min(end, first + _BATCH)
            fill_batch(splats, gaussians, first, last, end, _BATCH, (x0, y0), held[:2], faintest, batch, True)
            reaching(batch, _BATCH, int64(0), by_block)
            reaching(batch, _BATCH, int64(_WORD), by_block + 4 * BLOCKS)
            due = last * n_rows // n_pairs
            for k in range(BLOCKS):
                prefetch_gaussians(splats, gaussians, last + _SHARE * k, _SHARE, end)
                bit = uint32(1) << uint32(k)
                if live & bit == 0:
                    put_integer(by_block, k, uint32(0))
                    put_integer(by_block, BLOCKS + k, uint32(0))
                elif integer(by_block, k) | integer(by_block, BLOCKS + k) != 0:
                    if noted:
                        on = _blend_block(k, splats, batch, by_block, held, faintest, state, True)
                    else:
                        on = _blend_block(k, splats, batch, by_block, held, faintest, state, False)
                    if not on:
                        live &= ~bit
                if row < due:
                    write_blank(row, row + 1, blank_rows, n_x, frame, nothing, image, transmittance)
                    row += 1
            if noted:
                _note_seen(by_block, last - first, seen_in + 4 * first)
            first = last
        if noted:
            reached[first:end] = uint32(0)
        # an atomic waits until all writes are in the cache: so before the picture is written, not after
        item = fetch_add(counter)
        write_tile(state, x0, y0, frame, image, transmittance)
        write_blank(row, end * n_rows // n_pairs, blank_rows, n_x, frame, nothing, image, transmittance)
    keep(memory)
    keep(blank)


@kernel
def _parts(order, tile_start, n_x, height):
    """The tiles that have pairs, in the order given, and the rows of pixels of those that have none, for `write_blank`.

    These as they lie: what is next in memory is written next.
    """
    some, blank = np.empty(len(order), np.int32), np.empty(n_x * height, np.int32)
    n_some, n_blank = 0, 0
    for tile in order:
        some[n_some] = tile
        n_some += tile_start[tile] < tile_start[tile + 1]
    columns = np.empty(n_x, np.int32)
    for y in range(0, height, TILE):
        first, count = y // TILE * n_x, 0
        for column in range(n_x):
            columns[count] = column
            count += tile_start[first + column] == tile_start[first + column + 1]
        for row in range(y, min(y + TILE, height)):
            for k in range(count):
                blank[n_blank + k] = row * n_x + columns[k]
            n_blank += count
    return some[:n_some], blank[:n_blank]


def blend_forward(
    splats: np.ndarray,
    tile_start: np.ndarray,
    pair_gaussian: np.ndarray,
    width: int,
    height: int,
    image: np.ndarray,
    transmittance: np.ndarray,
    alpha_min: float = ALPHA_MIN,
    reached: np.ndarray | None = None,
) -> None:
    """Composite. `image` [H, W, FEATURES] and `transmittance` [H, W] are written; no background is added.

    `reached` [P] uint32, if given, gets the blocks of its tile in which each pair is seen, for `blend_backward`.
    """
    if reached is None:
        reached = np.empty(0, np.uint32)
    tables, frame = (tile_start, pair_gaussian, TABLE, reached), (width, height)
    order, counter = work(tile_start)
    parts = _parts(order, tile_start, -(-width // TILE), height)
    _forward(parts, counter, tables, frame, splats, image, transmittance, alpha_min)
