"""Front-to-back compositing of the tile lists, [3DGS] Eq. (3). Blocks, tiles and threads as in `tiles.py`.

Pairs are taken a batch at a time, and within a batch the blocks one after the other: what a block's pixels have
gathered stays in registers while all of the batch's Gaussians that reach it are added.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import math

import numpy as np
from numba import float32, int64, njit, prange, uint32, uint64

from tg4mm.rasterize.kernels.ahead import log2_alpha, look_ahead, reaching, room, row_of
from tg4mm.rasterize.kernels.compiled import kernel
from tg4mm.rasterize.kernels.lanes import rows_of_planes, store_block
from tg4mm.rasterize.kernels.layout import ALPHA_MIN, FEAT, FEATURES, TILE
from tg4mm.rasterize.kernels.masks import highest_bits, shifted
from tg4mm.rasterize.kernels.memory import (
    address,
    fetch_add,
    integer,
    keep,
    load,
    number,
    put_integer,
    store,
)
from tg4mm.rasterize.kernels.tiles import (
    BLOCKS,
    TABLE,
    aligned,
    alphas,
    ask_for_pairs,
    constants,
    corner,
    inside,
    pixel,
    work,
)
from tg4mm.rasterize.kernels.vector import LANES, bits, fma_where, lowest_bit, select, wide

_WORD = 32
_BATCH = 2 * _WORD  # pairs, a bit each
_ROOM = room(_BATCH)
_STRIDE = (2 + FEATURES) * LANES  # planes of a block: transmittance as it runs on, as it stopped, features


@njit(error_model="numpy", inline="always")
def _blend_block(k, splats, batch, by_block, held, faintest, state):
    """Add the pairs of a batch that may reach block k, and write in which of them it is seen. Does it still take light?

    The transmittance runs on where a pixel has stopped: it falls, so that nothing more is added. That way the next pair
    waits for no comparison. Nor does the loop end when no pixel is left: once for every block the processor would
    foresee it wrongly, which costs as much as the rest of a batch.
    """
    _, lane_y, powers, alpha_max, t_min = held
    place = k * _STRIDE
    t, left = load(state, place), load(state, place + LANES)
    f0, f1 = load(state, place + 2 * LANES), load(state, place + 3 * LANES)
    f2, f3 = load(state, place + 4 * LANES), load(state, place + 5 * LANES)
    on = t > t_min
    todo = uint64(integer(by_block, k)) | uint64(integer(by_block, BLOCKS + k)) << uint64(_WORD)
    seen_in = uint64(0)
    while todo != 0:
        n = lowest_bit(todo)
        rest = todo & (todo - uint64(1))
        y = log2_alpha(batch, _BATCH, n, k, lane_y)
        alpha, _, seen = alphas(y, faintest, alpha_max, powers)
        # a pixel that stops here may give nothing, but counts
        seen_in |= (todo ^ rest) if bits(on & seen) != 0 else uint64(0)
        todo = rest
        w = t * alpha
        t = t - w
        on = t > t_min
        left = select(on, t, left)
        features = row_of(batch, _BATCH, n) + FEAT
        f0 = fma_where(on, w, number(splats, features), f0)
        f1 = fma_where(on, w, number(splats, features + 1), f1)
        f2 = fma_where(on, w, number(splats, features + 2), f2)
        f3 = fma_where(on, w, number(splats, features + 3), f3)
    put_integer(by_block, k, uint32(seen_in))
    put_integer(by_block, BLOCKS + k, uint32(seen_in >> uint64(_WORD)))
    store(state, place, t)
    store(state, place + LANES, left)
    store(state, place + 2 * LANES, f0)
    store(state, place + 3 * LANES, f1)
    store(state, place + 4 * LANES, f2)
    store(state, place + 5 * LANES, f3)
    return bits(on) != 0


@njit(inline="always")
def _note_seen(by_block, count, reached):
    """From the pairs in which each block is seen to the blocks in which each pair is seen."""
    for first in range(0, count, _WORD):
        here = min(count - first, int64(_WORD))
        words = shifted(load(by_block, first // _WORD * BLOCKS), uint32(_WORD - here))
        for n in range(here):
            put_integer(reached, first + here - 1 - n, highest_bits(words))
            words = shifted(words, uint32(1))


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
    faintest, noted = float32(math.log2(alpha_min)), len(reached) > 0
    held = constants(table)
    memory = aligned(BLOCKS * _STRIDE + _ROOM + 2 * BLOCKS)
    state = address(memory)
    batch = state + 4 * BLOCKS * _STRIDE
    by_block = batch + 4 * _ROOM
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
        live = inside(min(TILE, height - y0), min(TILE, width - x0))
        first = begin
        while first < end and live != 0:
            last = min(end, first + _BATCH)
            look_ahead(splats, gaussians, first, last, end, _BATCH, (x0, y0), held[:2], faintest, batch, True)
            store(by_block, int64(0), reaching(batch, _BATCH, int64(0)))
            store(by_block, int64(BLOCKS), reaching(batch, _BATCH, int64(_WORD)))
            for k in range(BLOCKS):
                bit = uint32(1) << uint32(k)
                if live & bit == 0:
                    put_integer(by_block, k, uint32(0))
                    put_integer(by_block, BLOCKS + k, uint32(0))
                elif not _blend_block(k, splats, batch, by_block, held, faintest, state):
                    live &= ~bit
            if noted:
                _note_seen(by_block, last - first, seen_in + 4 * first)
            first = last
        if noted:
            reached[first:end] = uint32(0)
        _write(state, x0, y0, frame, image, transmittance)
    keep(memory)


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
        reached = np.empty(0, np.uint32)
    tables, frame = (tile_start, pair_gaussian, TABLE, reached), (width, height)
    _forward(*work(tile_start), tables, frame, splats, image, transmittance, alpha_min)
