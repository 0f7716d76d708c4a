"""Shared parts of the kernels that blend tiles: pixel positions, a Gaussian's alphas, distribution of tiles.

A tile is cut into blocks, a block one vector of pixels: 4 × 4 with AVX-512, elsewhere 4 × 2 (`pixels` of
`simd/vector.py`). A kernel keeps a row of planes for each block, its state:
first the transmittance, then what it carries along. `block_culling.py` finds the blocks that a Gaussian's ellipse may
reach; the others are not touched. The exponent is a sum of two squares, p² + q² with p, q linear in the pixel, which
keeps thin ellipses exact.

A pixel that has stopped carries a negative transmittance: -T, of which nothing comes any more.

Threads take tiles from a common counter, those with long lists first. A tile's result depends on nothing but the tile.
"""

import math

import numpy as np
from numba import float32, int64, uint32

from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, FEATURES, SPLAT_WIDTH, T_MIN, TILE
from tg4mm.fit.rasterize.simd.functions import EXP2, EXP2_STEPS, exp2
from tg4mm.fit.rasterize.simd.memory import integer, load_pixels, prefetch_far
from tg4mm.fit.rasterize.simd.vector import LANES, PIXELS, broadcast_pixels, select

WIDTH, HEIGHT = 4, PIXELS // 4  # of a block, in pixels
COLUMNS = TILE // WIDTH  # of blocks in a tile, as many as a block is wide
BLOCKS = TILE * TILE // PIXELS
# Divisions by these numbers, as shifts: numba takes care of negative numbers otherwise.
BY_FOUR, BY_HEIGHT = 2, HEIGHT.bit_length() - 1
PREFETCH = 32  # pairs whose Gaussians are prefetched ahead of their use: they lie anywhere in memory

# What kernels read from memory: where pixels and blocks lie (lanes are pixels from their block's centre, then block
# centres from the tile's corner), then constants that are to stay in registers.
_LANE, _BLOCK = np.arange(PIXELS), np.arange(BLOCKS)
_PLACES = [
    _LANE % WIDTH - (WIDTH - 1) / 2, _LANE // WIDTH - (HEIGHT - 1) / 2,
    _BLOCK % COLUMNS * WIDTH + WIDTH / 2, _BLOCK // COLUMNS * HEIGHT + HEIGHT / 2,
]  # fmt: skip
CENTRE_X, CENTRE_Y = 2 * PIXELS, 2 * PIXELS + BLOCKS  # where block centres begin
_POWERS = 2 * (PIXELS + BLOCKS)
_STEPS = _POWERS + LANES
_LIMITS = _STEPS + len(EXP2_STEPS)
_SKIPPED = np.zeros(LANES - len(EXP2))  # so that vectors begin where a cache line does
TABLE = np.concatenate([*_PLACES, EXP2, _SKIPPED, EXP2_STEPS, [ALPHA_MAX, T_MIN]]).astype(np.float32)


@inlined
def pixel(r, c, stride):
    """Place of row r, column c of a tile in the first plane of its state, whose blocks are `stride` apart."""
    block = (r >> BY_HEIGHT) * COLUMNS + (c >> BY_FOUR)
    return block * stride + (r & (HEIGHT - 1)) * WIDTH + (c & (WIDTH - 1))


@inlined
def corner(k, x0, y0, width):
    """Place of the first pixel of block k in a picture `width` wide, the tile beginning at x0, y0."""
    return int64((y0 + (k >> BY_FOUR) * HEIGHT) * width + x0 + (k & (COLUMNS - 1)) * WIDTH)


@inlined
def aligned(n):
    """n float32 at an address that is a multiple of 64: no vector straddles two cache lines."""
    room = np.empty(n + LANES, np.float32)
    skip = (-(room.ctypes.data // 4)) % LANES
    return room[skip : skip + n]


@inlined
def fill(state, stride, transmittance):
    """The first plane to `transmittance`, the others to 0. A block's planes follow each other in `state`."""
    state[:] = float32(0.0)
    for k in range(BLOCKS):
        state[k * stride : k * stride + PIXELS] = transmittance


@inlined
def inside(rows, columns):
    """Mask of the blocks that have a pixel in the image."""
    live = uint32(0)
    for k in range(BLOCKS):
        if (k >> BY_FOUR) * HEIGHT < rows and (k & (COLUMNS - 1)) * WIDTH < columns:
            live |= uint32(1) << uint32(k)
    return live


@inlined
def constants(table):
    """Load TABLE into registers: pixels' x and y from their block's centre, those of `exp2`, and ALPHA_MAX and T_MIN.

    As constants of the code they would be fetched anew, each with its address, in every round of a loop.
    """
    powers = (
        broadcast_pixels(table[_POWERS]), broadcast_pixels(table[_POWERS + 1]),
        broadcast_pixels(table[_POWERS + 2]), broadcast_pixels(table[_POWERS + 3]),
        broadcast_pixels(table[_POWERS + 4]), broadcast_pixels(table[_POWERS + 5]),
        broadcast_pixels(table[_POWERS + 6]), broadcast_pixels(table[_POWERS + 7]),
        broadcast_pixels(table[_POWERS + 8]), broadcast_pixels(table[_POWERS + 9]),
        load_pixels(table, int64(_STEPS)), load_pixels(table, int64(_STEPS + LANES)),
    )  # fmt: skip
    lanes = load_pixels(table, int64(0)), load_pixels(table, int64(PIXELS))
    return lanes[0], lanes[1], powers, broadcast_pixels(table[_LIMITS]), broadcast_pixels(table[_LIMITS + 1])


@inlined
def prefetch_pairs(splats, pair_gaussian, begin, end):
    """Prefetch the Gaussians of the first pairs of a later list."""
    for pair in range(begin, min(end, begin + 2 * PREFETCH)):
        prefetch_far(splats, int64(integer(pair_gaussian, pair)) * SPLAT_WIDTH)


@inlined
def prefetch_pixels(tile, n_x, frame, image, transmittance):
    """Prefetch the pixels of a later tile."""
    width, height = frame
    x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
    for r in range(y0, min(y0 + TILE, height)):
        at = int64(r * width + x0)
        prefetch_far(transmittance, at)
        for c in range(FEATURES):
            prefetch_far(image, at * FEATURES + c * LANES)


@inlined
def alphas(y, faintest, alpha_max, powers):
    """Return, from y = log2 of the unbounded alpha, alpha, 0 where too faint.

    Where it follows y; where it is bright enough.
    """
    raw = exp2(y, powers)
    free, seen = alpha_max > raw, y >= faintest
    return select(seen, select(free, raw, alpha_max), float32(0.0)), free, seen


@inlined
def alphas_unbounded(y, faintest, alpha_max, powers):
    """Return, from y, alpha, and what it would be without an upper bound; 0 where too faint."""
    raw = select(y >= faintest, exp2(y, powers), float32(0.0))
    return select(alpha_max > raw, raw, alpha_max), raw


@kernel
def _longest_first(tile_start):
    """Tiles by falling length of their lists, to the next power of √2; equal ones as they lie."""
    n = len(tile_start) - 1
    count = np.zeros(66, np.int64)
    rank = np.empty(n, np.uint8)
    for tile in range(n):
        length = tile_start[tile + 1] - tile_start[tile]
        rank[tile] = 64 - min(64, int(2.0 * math.log2(length)) + 1) if length > 0 else 64
        count[rank[tile] + 1] += 1
    for k in range(65):
        count[k + 1] += count[k]
    order = np.empty(n, np.int32)
    for tile in range(n):
        order[count[rank[tile]]] = tile
        count[rank[tile]] += 1
    return order


def work(tile_start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tiles in the order in which threads take them, and their common counter."""
    return _longest_first(tile_start), np.zeros(1, np.int64)
