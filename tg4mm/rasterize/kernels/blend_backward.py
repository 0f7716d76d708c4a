"""The gradient of compositing, also front to back. Blocks, tiles and threads as in `tiles.py`.

The gradient of a contribution needs the light that comes from behind it. Instead of walking back to front, this pass
starts from the finished image and takes each contribution away as it meets it, so both passes run the same recurrence
and nothing but the image is kept between them, and where each pair was seen.

Here a Gaussian's blocks follow each other: its sums stay in registers, the pixels' state lies in memory.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import math

import numpy as np
from numba import float32, int64, njit, prange, uint32

from tg4mm.rasterize.kernels.compiled import kernel
from tg4mm.rasterize.kernels.lanes import (
    fetch_add,
    lane_sums,
    load,
    load_block,
    planes_of_rows,
    store,
)
from tg4mm.rasterize.kernels.layout import (
    ALPHA_MIN,
    CA,
    CB,
    CC,
    FEAT,
    FEATURES,
    MX,
    MY,
    OP,
    SPLAT_WIDTH,
    TILE,
)
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
    pixel,
    top_of,
    work,
)
from tg4mm.rasterize.kernels.vector import LANES, bits, fma, lowest_bit, magnitude, negative, select, wide

_BATCH = 32  # pairs looked at ahead
# planes of a block: transmittance, what is still to come (as seen by the loss), gradient by the features
_STRIDE = (2 + FEATURES) * LANES


@njit(error_model="numpy", inline="always")
def _look_ahead(splats, pair_gaussian, first, last, end, x0, y0, table, offsets):
    """p and q at the blocks' centres of the pairs first … last, so that the loop over blocks does not wait for them."""
    for n in range(last - first):
        p, q = at_centres(splats, pair_gaussian, first + n, end, x0, y0, table)
        store(offsets, n * 2 * LANES, p)
        store(offsets, n * 2 * LANES + LANES, q)


@njit(inline="always")
def _planes_of(picture, at, step):
    """The four channels of the block that begins at `at` in a picture [H · W · FEATURES] whose rows are `step` long."""
    return planes_of_rows(
        load(picture, at),
        load(picture, at + step),
        load(picture, at + 2 * step),
        load(picture, at + 3 * step),
    )


@njit(inline="always")
def _read(state, x0, y0, frame, pictures):
    """A tile's state, nothing met yet, from the flat pictures and their gradients."""
    width, height = frame
    image, transmittance, v_image, v_transmittance = pictures
    rows, columns = min(TILE, height - y0), min(TILE, width - x0)
    if rows == TILE and columns == TILE:
        step, stride = int64(width * FEATURES), int64(width)
        for k in range(BLOCKS):
            place, at = k * _STRIDE, corner(k, x0, y0, width)
            to_come = load_block(v_transmittance, at, stride) * load_block(transmittance, at, stride)
            g0, g1, g2, g3 = _planes_of(v_image, at * FEATURES, step)
            i0, i1, i2, i3 = _planes_of(image, at * FEATURES, step)
            to_come = to_come + g0 * i0 + g1 * i1 + g2 * i2 + g3 * i3
            store(state, place, wide(float32(1.0)))
            store(state, place + LANES, to_come)
            store(state, place + 2 * LANES, g0)
            store(state, place + 3 * LANES, g1)
            store(state, place + 4 * LANES, g2)
            store(state, place + 5 * LANES, g3)
        return
    fill(state, _STRIDE, float32(-1.0))  # outside the image: stopped from the start
    for r in range(rows):
        for j in range(columns):
            at, of = pixel(r, j, _STRIDE), (y0 + r) * width + x0 + j
            to_come = v_transmittance[of] * transmittance[of]
            for k in range(FEATURES):
                g = v_image[of * FEATURES + k]
                state[(2 + k) * LANES + at] = g
                to_come += g * image[of * FEATURES + k]
            state[at] = float32(1.0)
            state[LANES + at] = to_come


@njit(error_model="numpy", inline="always")
def _pair_sums(splats, i, todo, live, x0, y0, faintest, table, held, offsets, at, state):
    """Gradient of a pair by the columns of `splats`, summed over its blocks `todo`; and the blocks still live."""
    lane_x, lane_y, powers, alpha_max, t_min = held
    one, half, zero = float32(1.0), float32(0.5), float32(0.0)
    nothing = wide(zero)
    s, sx, sy, sxx, sxy = nothing, nothing, nothing, nothing, nothing
    syy, h0, h1, h2, h3 = nothing, nothing, nothing, nothing, nothing
    l11, l12, l22 = exponent(splats, i)
    top = top_of(splats, i, faintest)
    at_p, at_q = fma(lane_x, l11, lane_y * l12), lane_y * l22
    at_x = lane_x + (float32(x0) - splats[i, MX])
    at_y = lane_y + (float32(y0) - splats[i, MY])
    f0, f1 = splats[i, FEAT], splats[i, FEAT + 1]
    f2, f3 = splats[i, FEAT + 2], splats[i, FEAT + 3]
    while todo != 0:
        k = lowest_bit(todo)
        todo &= todo - uint32(1)
        place = k * _STRIDE
        p, q = at_p + offsets[at + k], at_q + offsets[at + LANES + k]
        y = fma(negative(q), q, fma(negative(p), p, top))
        alpha, free, _ = alphas(y, faintest, alpha_max, powers)
        t = load(state, place)
        nt = fma(negative(t), alpha, t)
        on = nt > t_min
        w = select(on, t * alpha, zero)
        g0, g1 = load(state, place + 2 * LANES), load(state, place + 3 * LANES)
        g2, g3 = load(state, place + 4 * LANES), load(state, place + 5 * LANES)
        light = fma(g3, f3, fma(g2, f2, fma(g1, f1, g0 * f0)))
        to_come = fma(negative(w), light, load(state, place + LANES))
        store(state, place, select(on, nt, negative(magnitude(t))))
        store(state, place + LANES, to_come)
        # alpha = o e^(-sigma), so its gradient by -sigma is alpha itself; clamped ones give none
        v = select(on & free, alpha * (t * light - to_come / (one - alpha)), zero)
        dx, dy = at_x + table[2 * LANES + k], at_y + table[3 * LANES + k]
        vx, vy = v * dx, v * dy
        s, sx, sy = s + v, sx + vx, sy + vy
        sxx, sxy, syy = fma(vx, dx, sxx), fma(vx, dy, sxy), fma(vy, dy, syy)
        h0, h1, h2, h3 = fma(w, g0, h0), fma(w, g1, h1), fma(w, g2, h2), fma(w, g3, h3)
        if bits(on) == 0:
            live &= ~(uint32(1) << uint32(k))
    a, b, c = splats[i, CA], splats[i, CB], splats[i, CC]
    sums = lane_sums(
        fma(sx, a, sy * b), fma(sx, b, sy * c), sxx * -half, negative(sxy), syy * -half,
        s * (one / splats[i, OP]), h0, h1, h2, h3,
    )  # fmt: skip
    return sums, live


@kernel()
def _backward_tiles(order, counter, tables, frame, splats, pictures, v_pairs, alpha_min):
    tile_start, pair_gaussian, table, reached = tables
    width, height = frame
    image, transmittance, v_image, v_transmittance = pictures
    flat = image.reshape(-1), transmittance.reshape(-1), v_image.reshape(-1), v_transmittance.reshape(-1)
    n_x = (width + TILE - 1) // TILE
    faintest = float32(math.log2(alpha_min))
    held = constants(table)
    state = aligned(BLOCKS * _STRIDE)
    offsets = aligned(_BATCH * 2 * LANES)
    while True:
        item = fetch_add(counter)
        if item >= len(order):
            break
        tile = order[item]
        begin, end = tile_start[tile], tile_start[tile + 1]
        if begin == end:
            continue
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        _read(state, x0, y0, frame, flat)
        live = inside(min(TILE, height - y0), min(TILE, width - x0))
        for pair in range(begin, end):
            at = (pair - begin) % _BATCH
            if at == 0:
                last = min(end, pair + _BATCH)
                _look_ahead(splats, pair_gaussian, pair, last, end, x0, y0, table, offsets)
            todo = reached[pair] & live
            if todo == 0:
                store(v_pairs, int64(pair) * SPLAT_WIDTH, wide(float32(0.0)))
                continue
            sums, live = _pair_sums(
                splats, pair_gaussian[pair], todo, live, x0, y0, faintest, table, held, offsets,
                at * 2 * LANES, state,
            )  # fmt: skip
            store(v_pairs, int64(pair) * SPLAT_WIDTH, sums)
            if live == 0:
                v_pairs[(pair + 1) * SPLAT_WIDTH : end * SPLAT_WIDTH] = float32(0.0)
                break


@kernel(parallel=True)
def _backward(workers, order, counter, tables, frame, splats, pictures, v_pairs, alpha_min):
    for _ in prange(workers):
        _backward_tiles(order, counter, tables, frame, splats, pictures, v_pairs, alpha_min)


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
    v_pairs: np.ndarray,
    alpha_min: float = ALPHA_MIN,
    reached: np.ndarray | None = None,
) -> None:
    """Gradient of every (tile, Gaussian) pair, to `v_pairs` [P, SPLAT_WIDTH], in the columns of `splats`; 0 in
    those that blending does not read.

    v_image [H, W, FEATURES] and v_transmittance [H, W] are the loss's gradients by what blend_forward wrote. Without
    its `reached` every Gaussian is looked for in all blocks of its tiles: the same gradients, several times slower.
    """
    if reached is None:
        reached = np.full(len(pair_gaussian), (1 << BLOCKS) - 1, np.uint32)
    tables, frame = (tile_start, pair_gaussian, TABLE, reached), (width, height)
    pictures = (image, transmittance, v_image, v_transmittance)
    _backward(*work(tile_start), tables, frame, splats, pictures, v_pairs.reshape(-1), alpha_min)
