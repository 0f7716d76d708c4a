"""Front-to-back compositing of the tile lists, [3DGS] Eq. (3). Blocks, tiles and threads as in `tiles.py`.

Pairs are taken a batch at a time, and within a batch the blocks one after the other: what a block's pixels have
gathered stays in registers while all of the batch's Gaussians that reach it are added.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import math

import numpy as np
from numba import float32, int64, njit, prange, uint32, uint64

from tg4mm.rasterize.kernels.compiled import kernel
from tg4mm.rasterize.kernels.lanes import marked, rows_of_planes, store_block, with_bit
from tg4mm.rasterize.kernels.layout import ALPHA_MIN, FEAT, FEATURES, SPLAT_WIDTH, TILE
from tg4mm.rasterize.kernels.memory import (
    address,
    ask,
    fetch_add,
    integer,
    keep,
    load,
    number,
    put_integer,
    put_number,
    store,
)
from tg4mm.rasterize.kernels.tiles import (
    AHEAD,
    BLOCKS,
    LINES,
    TABLE,
    aligned,
    alphas,
    ask_for_pairs,
    centres,
    constants,
    corner,
    inside,
    keep_lines,
    log2_alpha,
    pixel,
    reach_of_lines,
    work,
)
from tg4mm.rasterize.kernels.vector import LANES, bits, fma_where, lowest_bit, select, wide

_HALF = 32
_BATCH = 2 * _HALF  # pairs, a bit each
_STRIDE = (2 + FEATURES) * LANES  # planes of a block: transmittance as it runs on, as it stopped, features


@njit(error_model="numpy", inline="always")
def _look_ahead(splats, pair_gaussian, first, last, end, table, lanes, blocks, faintest, batch):
    """Of the pairs first … last, what blending needs, and for each block which of them may reach it."""
    lines, tops, rows, by_block = batch
    n = int64(0)
    for half in range(2):
        words, bit = wide(float32(0.0)), uint32(1)
        for _ in range(max(0, min(last - first - half * _HALF, _HALF))):
            pair = first + n
            ask(splats, int64(integer(pair_gaussian, min(pair + AHEAD, end - 1))) * SPLAT_WIDTH)
            row = int64(integer(pair_gaussian, pair)) * SPLAT_WIDTH
            kept = keep_lines(splats, row, lines, n * LINES, table, lanes, blocks)
            reach, limit = reach_of_lines(splats, row, table, kept)
            put_number(tops, n, limit + faintest)
            put_integer(rows, n, uint32(row))
            words = marked(words, reach, bit)
            bit <<= uint32(1)
            n += 1
        store(by_block, int64(half * BLOCKS), words)


@njit(error_model="numpy", inline="always")
def _blend_block(k, todo, splats, batch, held, faintest, state):
    """Add the pairs `todo` of a batch to block k. Returns in which of them it is seen, and if it still takes light.

    The transmittance runs on where a pixel has stopped: it falls, so that nothing more is added. That way the next pair
    waits for no comparison. Nor does the loop end when no pixel is left: once for every block the processor would
    foresee it wrongly, which costs as much as the rest of a batch.
    """
    lines, tops, rows, _ = batch
    _, _, powers, alpha_max, t_min = held
    place, seen_in = k * _STRIDE, uint64(0)
    t, left = load(state, place), load(state, place + LANES)
    f0, f1 = load(state, place + 2 * LANES), load(state, place + 3 * LANES)
    f2, f3 = load(state, place + 4 * LANES), load(state, place + 5 * LANES)
    on = t > t_min
    while todo != 0:
        n = lowest_bit(todo)
        rest = todo & (todo - uint64(1))
        y = log2_alpha(lines, n * LINES, k, number(tops, n))
        alpha, _, seen = alphas(y, faintest, alpha_max, powers)
        # a pixel that stops here may give nothing, but counts
        seen_in |= (todo ^ rest) if bits(on & seen) != 0 else uint64(0)
        todo = rest
        w = t * alpha
        t = t - w
        on = t > t_min
        left = select(on, t, left)
        features = int64(integer(rows, n)) + FEAT
        f0 = fma_where(on, w, number(splats, features), f0)
        f1 = fma_where(on, w, number(splats, features + 1), f1)
        f2 = fma_where(on, w, number(splats, features + 2), f2)
        f3 = fma_where(on, w, number(splats, features + 3), f3)
    store(state, place, t)
    store(state, place + LANES, left)
    store(state, place + 2 * LANES, f0)
    store(state, place + 3 * LANES, f1)
    store(state, place + 4 * LANES, f2)
    store(state, place + 5 * LANES, f3)
    return seen_in, bits(on) != 0


@njit(inline="always")
def _note_seen(by_block, count, reached):
    """From the pairs in which each block is seen to the blocks in which each pair is seen."""
    n = int64(0)
    for half in range(2):
        words, bit = load(by_block, int64(half * BLOCKS)), uint32(1)
        for _ in range(max(0, min(count - half * _HALF, _HALF))):
            put_integer(reached, n, with_bit(words, bit))
            bit <<= uint32(1)
            n += 1


@njit(inline="always")
def _begin(state):
    """Nothing met yet."""
    for k in range(BLOCKS):
        place = int64(k * _STRIDE)
        store(state, place, wide(float32(1.0)))
        store(state, place + LANES, wide(float32(1.0)))
        for c in range(FEATURES):
            store(state, place + (2 + c) * LANES, wide(float32(0.0)))


@njit(inline="always")
def _write(state, x0, y0, frame, image, transmittance):
    """A tile's state to the picture [H · W · FEATURES] and the transmittance [H · W]."""
    width, height = frame
    rows, columns = min(TILE, height - y0), min(TILE, width - x0)
    if rows == TILE and columns == TILE:
        step = int64(width * FEATURES)
        for k in range(BLOCKS):
            place, at = k * _STRIDE, corner(k, x0, y0, width)
            r0, r1, r2, r3 = rows_of_planes(
                load(state, place + 2 * LANES), load(state, place + 3 * LANES), load(state, place + 4 * LANES),
                load(state, place + 5 * LANES),
            )  # fmt: skip
            store_block(transmittance, at, int64(width), load(state, place + LANES))
            at *= FEATURES
            store(image, at, r0)
            store(image, at + step, r1)
            store(image, at + 2 * step, r2)
            store(image, at + 3 * step, r3)
        return
    for r in range(rows):
        for j in range(columns):
            at, to = pixel(r, j, _STRIDE), (y0 + r) * width + x0 + j
            transmittance[to] = number(state, LANES + at)
            for k in range(FEATURES):
                image[to * FEATURES + k] = number(state, (2 + k) * LANES + at)


@njit(inline="always")
def _write_nothing(tile, n_x, tile_start, frame, image, transmittance):
    """The tiles of a row that no Gaussian reaches, from one on; nothing where it is not the first of them."""
    width, height = frame
    column = tile % n_x
    if column > 0 and tile_start[tile - 1] == tile_start[tile]:
        return
    stop = tile + 1
    while stop % n_x != 0 and tile_start[stop] == tile_start[stop + 1]:
        stop += 1
    x0, x1, y0 = column * TILE, min(width, (column + stop - tile) * TILE), (tile // n_x) * TILE
    one = wide(float32(1.0))
    for r in range(y0, min(y0 + TILE, height)):
        at, last = int64(r * width + x0), int64(r * width + x1)
        image[at * FEATURES : last * FEATURES] = float32(0.0)
        while at + LANES <= last:
            store(transmittance, at, one)
            at += LANES
        for x in range(at, last):
            transmittance[x] = float32(1.0)


@kernel()
def _forward_tiles(workers, order, counter, tables, frame, splats, image, transmittance, alpha_min):
    tile_start, pair_gaussian, table, reached = tables
    width, height = frame
    n_x = (width + TILE - 1) // TILE
    faintest = float32(math.log2(alpha_min))
    held = constants(table)
    room = aligned(BLOCKS * _STRIDE + _BATCH * (LINES + 2) + 2 * BLOCKS)
    state = address(room)
    lines = state + 4 * BLOCKS * _STRIDE
    tops = lines + 4 * _BATCH * LINES
    rows = tops + 4 * _BATCH
    by_block = rows + 4 * _BATCH
    batch = lines, tops, rows, by_block
    table_at = address(table)
    splats, gaussians, seen_in = address(splats), address(pair_gaussian), address(reached)
    image, transmittance = image.reshape(-1), transmittance.reshape(-1)
    while True:
        item = fetch_add(counter)
        if item >= len(order):
            break
        tile = order[item]
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        begin, end = int64(tile_start[tile]), int64(tile_start[tile + 1])
        if begin == end:
            _write_nothing(tile, n_x, tile_start, frame, image, transmittance)
            continue
        later = order[min(item + workers, len(order) - 1)]
        ask_for_pairs(splats, gaussians, int64(tile_start[later]), int64(tile_start[later + 1]))
        _begin(state)
        blocks = centres(table, x0, y0)
        live = inside(min(TILE, height - y0), min(TILE, width - x0))
        first = begin
        while first < end and live != 0:
            last = min(end, first + _BATCH)
            _look_ahead(splats, gaussians, first, last, end, table_at, held[:2], blocks, faintest, batch)
            for k in range(BLOCKS):
                todo = uint64(integer(by_block, k)) | uint64(integer(by_block, BLOCKS + k)) << uint64(_HALF)
                bit, seen = uint32(1) << uint32(k), uint64(0)
                if todo != 0 and live & bit != 0:
                    seen, alive = _blend_block(k, todo, splats, batch, held, faintest, state)
                    live &= ~uint32(0) if alive else ~bit
                put_integer(by_block, k, uint32(seen))
                put_integer(by_block, BLOCKS + k, uint32(seen >> uint64(_HALF)))
            _note_seen(by_block, last - first, seen_in + 4 * first)
            first = last
        reached[first:end] = uint32(0)
        _write(state, x0, y0, frame, image, transmittance)
    keep(room)


@kernel(parallel=True)
def _forward(workers, order, counter, tables, frame, splats, image, transmittance, alpha_min):
    for _ in prange(workers):
        _forward_tiles(workers, order, counter, tables, frame, splats, image, transmittance, alpha_min)


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
        reached = np.empty(len(pair_gaussian), np.uint32)
    tables, frame = (tile_start, pair_gaussian, TABLE, reached), (width, height)
    _forward(*work(tile_start), tables, frame, splats, image, transmittance, alpha_min)
