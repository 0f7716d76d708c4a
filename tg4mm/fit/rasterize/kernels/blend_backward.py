"""Gradient of compositing, also front to back. Blocks, tiles and threads as in `tiles.py`.

The gradient of a contribution needs the light from behind it. Instead of going back to front, this pass starts from the
finished image and subtracts each contribution, so that both passes run the same recurrence and only the image and the
blocks in which each pair was seen are kept between them.

Here a Gaussian's blocks follow each other: its sums stay in registers, the pixels' state is in memory.
"""

import math

import numpy as np
from numba import float32, int64, uint32, uint64

from tg4mm.fit.rasterize.kernels.block_culling import fill_batch, log2_alpha, room
from tg4mm.fit.rasterize.kernels.compiled import inlined, shared
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MIN, FEAT, FEATURES, MX, MY, SPLAT_WIDTH, TILE
from tg4mm.fit.rasterize.kernels.tiles import (
    BLOCKS,
    CENTRE_X,
    CENTRE_Y,
    TABLE,
    aligned,
    alphas_unbounded,
    constants,
    corner,
    pixel,
    prefetch_pairs,
    prefetch_pixels,
    work,
)
from tg4mm.fit.rasterize.simd.lanes import lane_sums, load_block
from tg4mm.fit.rasterize.simd.memory import (
    address,
    fetch_add,
    integer,
    keep,
    load_pixels,
    number,
    put_integer,
    put_number,
    store,
)
from tg4mm.fit.rasterize.simd.rows import load_planes
from tg4mm.fit.rasterize.simd.vector import (
    LANES,
    PIXELS,
    broadcast,
    broadcast_pixels,
    ctz,
    fma,
    popcount,
    put_places,
    select,
    with_avx512,
)

_BATCH = 16  # pairs of a batch
_MOST = 2048 // PIXELS  # blocks of theirs; the room for their alphas should stay within the first cache
_ROOM = room(_BATCH)
_AT_ONCE = 4  # blocks that are listed without a branch between them
_KEPT = 2 * PIXELS  # kept of each pair and block: alpha before it is bounded, alpha / (1 - alpha)
# planes of a block: transmittance, what is still to come (as seen by the loss), gradient by the features
_STRIDE = (2 + FEATURES) * PIXELS


@inlined
def _list_seen(reached, first, last, items):
    """List the blocks in which the pairs first … last are seen, as far as there is room.

    Returns how many they are, and the first pair that is not among them. An item is BLOCKS times the pair's place in
    the batch, plus the block.
    """
    count = int64(0)
    for n in range(last - first):
        if count > _MOST - BLOCKS:
            return count, first + n
        todo, base = integer(reached, first + n), uint32(n * BLOCKS)
        if with_avx512():
            put_places(items, count, todo, base)
            count += int64(popcount(todo))
            continue
        while todo != 0:
            # four at a time, whether they are there or not: most pairs then take a branch that can be foreseen
            found = int64(popcount(todo))
            for j in range(_AT_ONCE):
                put_integer(items, count + j, base + uint32(ctz(uint64(todo) | uint64(1 << BLOCKS))))
                todo &= todo - uint32(1)
            count += min(found, _AT_ONCE)
    return count, last


@inlined
def _precompute_alphas(count, items, batch, faintest, held, kept):
    """Compute the alphas of all items, for `_pair_sums`.

    There they would be half of a long chain of operations that wait for each other, of which the processor can hold two
    blocks' worth: it would wait most of the time.
    """
    _, lane_y, powers, alpha_max, _ = held
    one = float32(1.0)
    for c in range(count):
        item = int64(integer(items, c))
        n, k = item // BLOCKS, item % BLOCKS
        y = log2_alpha(batch, _BATCH, n, k, lane_y)
        alpha, raw = alphas_unbounded(y, faintest, alpha_max, powers)
        store(kept, c * _KEPT, raw)
        store(kept, c * _KEPT + PIXELS, alpha / (one - alpha))


@inlined
def _read(state, x0, y0, frame, pictures):
    """Load the initial state of a tile from the flat pictures and their gradients."""
    width, height = frame
    image, transmittance, v_image, v_transmittance = pictures
    rows, columns = min(TILE, height - y0), min(TILE, width - x0)
    if rows == TILE and columns == TILE:
        step, stride = int64(width * FEATURES), int64(width)
        for k in range(BLOCKS):
            place, at = k * _STRIDE, corner(k, x0, y0, width)
            to_come = load_block(v_transmittance, at, stride) * load_block(transmittance, at, stride)
            g0, g1, g2, g3 = load_planes(v_image, at * FEATURES, step)
            i0, i1, i2, i3 = load_planes(image, at * FEATURES, step)
            to_come = to_come + g0 * i0 + g1 * i1 + g2 * i2 + g3 * i3
            store(state, place, broadcast_pixels(float32(1.0)))
            store(state, place + PIXELS, to_come)
            store(state, place + 2 * PIXELS, g0)
            store(state, place + 3 * PIXELS, g1)
            store(state, place + 4 * PIXELS, g2)
            store(state, place + 5 * PIXELS, g3)
        return
    for k in range(BLOCKS):  # outside the image: stopped from the start
        store(state, k * _STRIDE, broadcast_pixels(float32(-1.0)))
        for plane in range(1, 2 + FEATURES):
            store(state, k * _STRIDE + plane * PIXELS, broadcast_pixels(float32(0.0)))
    for r in range(rows):
        for j in range(columns):
            at, of = pixel(r, j, _STRIDE), (y0 + r) * width + x0 + j
            to_come = v_transmittance[of] * transmittance[of]
            for k in range(FEATURES):
                g = v_image[of * FEATURES + k]
                put_number(state, (2 + k) * PIXELS + at, g)
                to_come += g * image[of * FEATURES + k]
            put_number(state, at, float32(1.0))
            put_number(state, PIXELS + at, to_come)


@inlined
def _moments(v, k, at_x, at_y, table, sums):
    """Add the moments of v, a block's gradient by the logarithm of alpha, about the Gaussian's mean."""
    s, sx, sy, sxx, sxy, syy = sums
    dx, dy = at_x + number(table, CENTRE_X + k), at_y + number(table, CENTRE_Y + k)
    vx, vy = v * dx, v * dy
    return s + v, sx + vx, sy + vy, fma(vx, dx, sxx), fma(vx, dy, sxy), fma(vy, dy, syy)


@inlined
def _pair_sums(splats, row, seen, x0, y0, table, held, kept, state):
    """Sums of a pair (layout.py) over the blocks in which it is seen, of which `kept` has the alphas.

    With sixteen registers the moments take a second loop: one loop would keep half of its sums in memory.
    """
    lane_x, lane_y, _, alpha_max, t_min = held
    zero = float32(0.0)
    nothing = broadcast_pixels(zero)
    moments = nothing, nothing, nothing, nothing, nothing, nothing
    h0, h1, h2, h3 = nothing, nothing, nothing, nothing
    at_x = lane_x + (float32(x0) - number(splats, row + MX))
    at_y = lane_y + (float32(y0) - number(splats, row + MY))
    f0, f1 = number(splats, row + FEAT), number(splats, row + FEAT + 1)
    f2, f3 = number(splats, row + FEAT + 2), number(splats, row + FEAT + 3)
    todo, at = seen, kept
    while todo != 0:
        k = ctz(todo)
        todo &= todo - uint32(1)
        place = k * _STRIDE
        raw, ratio = load_pixels(at, int64(0)), load_pixels(at, int64(PIXELS))
        free = alpha_max > raw
        t = load_pixels(state, place)
        w = t * select(free, raw, alpha_max)
        nt = t - w
        on = nt > t_min
        w = select(on, w, zero)
        g0, g1 = load_pixels(state, place + 2 * PIXELS), load_pixels(state, place + 3 * PIXELS)
        g2, g3 = load_pixels(state, place + 4 * PIXELS), load_pixels(state, place + 5 * PIXELS)
        light = fma(g3, f3, fma(g2, f2, fma(g1, f1, g0 * f0)))
        to_come = fma(-w, light, load_pixels(state, place + PIXELS))
        store(state, place, nt)
        store(state, place + PIXELS, to_come)
        # alpha = o e^(-sigma), so its gradient by -sigma is alpha itself; clamped ones give none
        v = select(on & free, fma(w, light, -(ratio * to_come)), zero)
        h0, h1, h2, h3 = fma(w, g0, h0), fma(w, g1, h1), fma(w, g2, h2), fma(w, g3, h3)
        if with_avx512():
            moments = _moments(v, k, at_x, at_y, table, moments)
        else:
            store(at, int64(0), v)
        at += 4 * _KEPT
    todo, at = seen, kept
    while todo != 0 and not with_avx512():
        moments = _moments(load_pixels(at, int64(0)), ctz(todo), at_x, at_y, table, moments)
        todo &= todo - uint32(1)
        at += 4 * _KEPT
    s, sx, sy, sxx, sxy, syy = moments
    return lane_sums(sx, sy, sxx, sxy, syy, s, h0, h1, h2, h3)


@shared
def _backward(_, workers, order, counter, tables, frame, splats, pictures, pair_sums, alpha_min):
    tile_start, pair_gaussian, table, reached = tables
    n_x = (frame[0] + TILE - 1) // TILE
    image, transmittance, v_image, v_transmittance = pictures
    flat = image.reshape(-1), transmittance.reshape(-1), v_image.reshape(-1), v_transmittance.reshape(-1)
    at_pictures = address(image), address(transmittance), address(v_image), address(v_transmittance)
    faintest = float32(math.log2(alpha_min))
    held = constants(table)
    memory = aligned(BLOCKS * _STRIDE + _ROOM + _MOST * (_KEPT + 1) + LANES)
    state = address(memory)
    batch = state + 4 * BLOCKS * _STRIDE
    kept = batch + 4 * _ROOM
    items = kept + 4 * _MOST * _KEPT
    splats, gaussians, seen_in = address(splats), address(pair_gaussian), address(reached)
    places, v_out = address(table), address(pair_sums)
    while True:
        item = fetch_add(counter)
        if item >= len(order):
            break
        tile = order[item]
        begin, end = int64(tile_start[tile]), int64(tile_start[tile + 1])
        if begin == end:
            continue
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        _read(state, x0, y0, frame, flat)
        later = order[min(item + workers, len(order) - 1)]
        prefetch_pixels(later, n_x, frame, at_pictures[0], at_pictures[1])
        prefetch_pixels(later, n_x, frame, at_pictures[2], at_pictures[3])
        prefetch_pairs(splats, gaussians, int64(tile_start[later]), int64(tile_start[later + 1]))
        seen_end = end  # where every pixel has stopped, nothing is seen any more
        while seen_end > begin and integer(seen_in, seen_end - 1) == 0:
            seen_end -= 1
            store(v_out, seen_end * SPLAT_WIDTH, broadcast(float32(0.0)))
        first = begin
        while first < seen_end:
            last = min(seen_end, first + _BATCH)
            fill_batch(
                splats, gaussians, first, last, seen_end, _BATCH, (x0, y0), held[:2], faintest, batch, False
            )
            count, last = _list_seen(seen_in, first, last, items)
            _precompute_alphas(count, items, batch, faintest, held, kept)
            here = kept
            for pair in range(first, last):
                todo, sums = integer(seen_in, pair), broadcast(float32(0.0))
                if todo != 0:
                    row = int64(integer(gaussians, pair)) * SPLAT_WIDTH
                    sums = _pair_sums(splats, row, todo, x0, y0, places, held, here, state)
                    here += 4 * _KEPT * int64(popcount(todo))
                store(v_out, pair * SPLAT_WIDTH, sums)
            first = last
    keep(memory)


def blend_backward(
    splats: np.ndarray,
    tile_start: np.ndarray,
    pair_gaussian: np.ndarray,
    width: int,
    height: int,
    image: np.ndarray,
    transmittance: np.ndarray,
    v_image: np.ndarray,
    v_transmittance: np.ndarray,
    pair_sums: np.ndarray,
    alpha_min: float = ALPHA_MIN,
    reached: np.ndarray | None = None,
) -> None:
    """Write each (tile, Gaussian) pair's part of the gradient to `pair_sums` [P, SPLAT_WIDTH], as in layout.py.

    v_image [H, W, FEATURES] and v_transmittance [H, W] are the loss's gradients by what blend_forward wrote. Without
    its `reached` every Gaussian is looked for in all blocks of its tiles: the same gradients, several times slower.
    """
    if reached is None:
        reached = np.full(len(pair_gaussian), (1 << BLOCKS) - 1, np.uint32)
    tables, frame = (tile_start, pair_gaussian, TABLE, reached), (width, height)
    pictures = (image, transmittance, v_image, v_transmittance)
    _backward(*work(tile_start), tables, frame, splats, pictures, pair_sums.reshape(-1), alpha_min)
