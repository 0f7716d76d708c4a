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
from tg4mm.rasterize.kernels.lanes import fetch_add, load, mark, rows_of_planes, store, store_block
from tg4mm.rasterize.kernels.layout import ALPHA_MIN, FEAT, FEATURES, TILE
from tg4mm.rasterize.kernels.tiles import (
    BLOCKS,
    TABLE,
    aligned,
    alphas,
    at_centres,
    constants,
    corner,
    exponent,
    fill,
    inside,
    may_reach,
    pixel,
    top_of,
    work,
)
from tg4mm.rasterize.kernels.vector import LANES, bits, fma, lowest_bit, magnitude, negative, select

_BATCH = 64  # pairs, a bit each
_LINES = 4 * LANES  # kept of each: p and q at the blocks' centres, and what they differ by within a block
_NUMBERS = 8  # the exponent's largest value and the features
_STRIDE = (1 + FEATURES) * LANES  # planes of a block: transmittance, features


@njit(error_model="numpy", inline="always")
def _look_ahead(splats, pair_gaussian, first, last, end, x0, y0, table, faintest, batch):
    """Of the pairs first … last, what blending needs, and for each block which of them may reach it."""
    lines, numbers, by_block = batch
    lane_x, lane_y = load(table, int64(0)), load(table, int64(LANES))
    for k in range(2 * BLOCKS):
        by_block[k] = uint32(0)
    for n in range(last - first):
        i = pair_gaussian[first + n]
        p, q = at_centres(splats, pair_gaussian, first + n, end, x0, y0, table)
        l11, l12, l22 = exponent(splats, i)
        at = n * _LINES
        store(lines, at, p)
        store(lines, at + LANES, q)
        store(lines, at + 2 * LANES, fma(lane_x, l11, lane_y * l12))
        store(lines, at + 3 * LANES, lane_y * l22)
        numbers[n, 0] = top_of(splats, i, faintest)
        for c in range(FEATURES):
            numbers[n, 1 + c] = splats[i, FEAT + c]
        mark(by_block, (n >> 5) * BLOCKS, may_reach(splats, i, p, q), uint32(1) << uint32(n & 31))


@njit(error_model="numpy", inline="always")
def _blend_block(k, todo, live, batch, held, faintest, state, reached):
    """Add the pairs `todo` of a batch to block k. Returns the blocks still live."""
    lines, numbers, _ = batch
    _, _, powers, alpha_max, t_min = held
    place, bit = k * _STRIDE, uint32(1) << uint32(k)
    t = load(state, place)
    f0, f1 = load(state, place + LANES), load(state, place + 2 * LANES)
    f2, f3 = load(state, place + 3 * LANES), load(state, place + 4 * LANES)
    while todo != 0:
        n = lowest_bit(todo)
        todo &= todo - uint64(1)
        at = n * _LINES
        p = load(lines, at + 2 * LANES) + lines[at + k]
        q = load(lines, at + 3 * LANES) + lines[at + LANES + k]
        y = fma(negative(q), q, fma(negative(p), p, numbers[n, 0]))
        alpha, _, seen = alphas(y, faintest, alpha_max, powers)
        # a pixel that stops here may give nothing, but counts
        reached[uint64(n)] |= bit if bits(seen & (t > float32(0.0))) != 0 else uint32(0)
        nt = fma(negative(t), alpha, t)
        on = nt > t_min
        w = select(on, t * alpha, float32(0.0))
        t = select(on, nt, negative(magnitude(t)))
        f0, f1 = fma(w, numbers[n, 1], f0), fma(w, numbers[n, 2], f1)
        f2, f3 = fma(w, numbers[n, 3], f2), fma(w, numbers[n, 4], f3)
        if bits(on) == 0:
            live &= ~bit
            break
    store(state, place, t)
    store(state, place + LANES, f0)
    store(state, place + 2 * LANES, f1)
    store(state, place + 3 * LANES, f2)
    store(state, place + 4 * LANES, f3)
    return live


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
                load(state, place + LANES), load(state, place + 2 * LANES), load(state, place + 3 * LANES),
                load(state, place + 4 * LANES),
            )  # fmt: skip
            store_block(transmittance, at, int64(width), magnitude(load(state, place)))
            at *= FEATURES
            store(image, at, r0)
            store(image, at + step, r1)
            store(image, at + 2 * step, r2)
            store(image, at + 3 * step, r3)
        return
    for r in range(rows):
        for j in range(columns):
            at, to = pixel(r, j, _STRIDE), (y0 + r) * width + x0 + j
            transmittance[to] = abs(state[at])
            for k in range(FEATURES):
                image[to * FEATURES + k] = state[(1 + k) * LANES + at]


@njit(inline="always")
def _write_nothing(x0, y0, frame, image, transmittance):
    """A tile that no Gaussian reaches."""
    width, height = frame
    columns = min(TILE, width - x0)
    for r in range(y0, min(y0 + TILE, height)):
        at = r * width + x0
        transmittance[at : at + columns] = float32(1.0)
        image[at * FEATURES : (at + columns) * FEATURES] = float32(0.0)


@kernel()
def _forward_tiles(order, counter, tables, frame, splats, image, transmittance, alpha_min):
    tile_start, pair_gaussian, table, reached = tables
    width, height = frame
    n_x = (width + TILE - 1) // TILE
    faintest = float32(math.log2(alpha_min))
    held = constants(table)
    state = aligned(BLOCKS * _STRIDE)
    batch = (
        aligned(_BATCH * _LINES),
        np.empty((_BATCH, _NUMBERS), np.float32),
        np.empty(2 * BLOCKS, np.uint32),
    )
    image, transmittance = image.reshape(-1), transmittance.reshape(-1)
    while True:
        item = fetch_add(counter)
        if item >= len(order):
            break
        tile = order[item]
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        begin, end = tile_start[tile], tile_start[tile + 1]
        if begin == end:
            _write_nothing(x0, y0, frame, image, transmittance)
            continue
        reached[begin:end] = uint32(0)
        fill(state, _STRIDE, float32(1.0))
        live = inside(min(TILE, height - y0), min(TILE, width - x0))
        for first in range(begin, end, _BATCH):
            last = min(end, first + _BATCH)
            _look_ahead(splats, pair_gaussian, first, last, end, x0, y0, table, faintest, batch)
            for k in range(BLOCKS):
                todo = uint64(batch[2][k]) | uint64(batch[2][BLOCKS + k]) << uint64(32)
                if todo != 0 and (live >> uint32(k)) & uint32(1) != 0:
                    live = _blend_block(k, todo, live, batch, held, faintest, state, reached[first:last])
            if live == 0:
                break
        _write(state, x0, y0, frame, image, transmittance)


@kernel(parallel=True)
def _forward(workers, order, counter, tables, frame, splats, image, transmittance, alpha_min):
    for _ in prange(workers):
        _forward_tiles(order, counter, tables, frame, splats, image, transmittance, alpha_min)


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
