"""Front-to-back compositing of the tile lists, [3DGS] Eq. (3), and its gradient, also front to back.

The gradient of a contribution needs the light that comes from behind it. Instead of walking back to front,
the backward pass starts from the finished image and takes each contribution away as it meets it, so both
passes run the same recurrence and nothing but the image is kept between them.

A tile is 16 blocks of 4 × 4 pixels, a block one vector. For each Gaussian one vector test, a lane a block, says
which blocks its ellipse may reach; the others are not touched. The exponent is a sum of two squares, p² + q² with
p, q linear in the pixel, which keeps thin ellipses exact.

A pixel that has stopped carries a negative transmittance: -T, of which nothing comes any more.

Threads take tiles from a common counter, those with long lists first. A tile's result depends on nothing but the tile.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import math

import numpy as np
from numba import float32, get_num_threads, int64, njit, prange, uint32

from tg4mm.rasterize.kernels.compiled import kernel
from tg4mm.rasterize.kernels.layout import (
    ALPHA_MAX,
    ALPHA_MIN,
    CA,
    CB,
    CC,
    FEAT,
    FEATURES,
    L22,
    MX,
    MY,
    OP,
    POWER,
    R11,
    SQUARES,
    T_MIN,
    TILE,
)
from tg4mm.rasterize.kernels.vector import (
    LANES,
    bits,
    exp2,
    fetch_add,
    fma,
    lane_sums,
    load,
    lowest_bit,
    magnitude,
    negative,
    select,
    store,
    store_ten,
    wide,
)

_AREA = TILE * TILE
_SIDE = 4  # pixels of a block
BLOCKS = _AREA // LANES
BATCH = 32  # pairs looked at ahead
_GRAD = FEAT + FEATURES

# Where pixels and blocks lie: lanes are pixels from their block's centre, then block centres from the tile's corner.
_LANE = np.arange(LANES)
PLACES = np.stack(
    [_LANE % _SIDE - 1.5, _LANE // _SIDE - 1.5, _LANE % _SIDE * 4 + 2.0, _LANE // _SIDE * 4 + 2.0]
).astype(np.float32).ravel()  # fmt: skip


@njit(inline="always")
def pixel(r, c, stride):
    """Place of row r, column c of a tile in the first plane of its state, whose blocks are `stride` apart."""
    return ((r >> 2) * 4 + (c >> 2)) * stride + (r & 3) * _SIDE + (c & 3)


@njit(inline="always")
def aligned(n):
    """n float32 at an address that is a multiple of 64: no vector straddles two cache lines."""
    room = np.empty(n + LANES, np.float32)
    skip = (-(room.ctypes.data // 4)) % LANES
    return room[skip : skip + n]


@njit(inline="always")
def fill(state, stride, transmittance):
    """The first plane to `transmittance`, the others to 0. A block's planes follow each other in `state`."""
    state[:] = float32(0.0)
    for k in range(BLOCKS):
        state[k * stride : k * stride + LANES] = transmittance


@njit(inline="always")
def exponent(splats, i):
    """l11, l12, l22 of the exponent p² + q² of Gaussian i: p = l11 dx + l12 dy, q = l22 dy."""
    h = float32(SQUARES) * splats[i, R11]
    return h * splats[i, CA], h * splats[i, CB], splats[i, L22]


@njit(error_model="numpy", inline="always")
def look_ahead(splats, pair_gaussian, begin, end, x0, y0, places, masks, offsets):
    """For the pairs begin … end: which blocks the ellipse may reach, and p and q at the blocks' centres [2 · 16].

    A block's p and q lie within a box around those of its centre; if the box's nearest point to the origin is outside
    the ellipse, so is the block. Done for a batch ahead, so that the branches of the loop over blocks, which depend
    on it, do not wait for it.
    """
    half, zero = float32(1.5), wide(float32(0.0))
    for n in range(end - begin):
        i = pair_gaussian[begin + n]
        l11, l12, l22 = exponent(splats, i)
        dx = load(places, int64(2 * LANES)) + (float32(x0) - splats[i, MX])
        dy = load(places, int64(3 * LANES)) + (float32(y0) - splats[i, MY])
        p, q = fma(dx, l11, dy * l12), dy * l22
        store(offsets, n * 2 * LANES, p)
        store(offsets, n * 2 * LANES + LANES, q)
        out_p = magnitude(p) - half * (abs(l11) + abs(l12))
        out_q = magnitude(q) - half * l22
        out_p = select(out_p > zero, out_p, zero)
        out_q = select(out_q > zero, out_q, zero)
        limit = splats[i, POWER] * float32(2.0 * SQUARES)
        masks[n] = bits(wide(limit) >= fma(out_p, out_p, out_q * out_q))


@njit(inline="always")
def inside(rows, columns):
    """Mask of the blocks that have a pixel in the image."""
    live = uint32(0)
    for k in range(BLOCKS):
        if (k >> 2) * 4 < rows and (k & 3) * 4 < columns:
            live |= uint32(1) << uint32(k)
    return live


@kernel()
def _forward_tiles(order, counter, tables, frame, splats, image, transmittance, alpha_min):
    tile_start, pair_gaussian, places, reached = tables
    width, height = frame
    n_x = (width + TILE - 1) // TILE
    one, zero = float32(1.0), float32(0.0)
    alpha_max, t_min = float32(ALPHA_MAX), float32(T_MIN)
    faintest = float32(math.log2(alpha_min))
    stride = (1 + FEATURES) * LANES
    state = aligned(BLOCKS * stride)
    offsets = aligned(BATCH * 2 * LANES)
    masks = np.empty(BATCH, np.uint32)
    while True:
        item = fetch_add(counter)
        if item >= len(order):
            break
        tile = order[item]
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        rows, columns = min(TILE, height - y0), min(TILE, width - x0)
        begin, end = tile_start[tile], tile_start[tile + 1]
        if begin == end:
            transmittance[y0 : y0 + rows, x0 : x0 + columns] = one
            image[y0 : y0 + rows, x0 : x0 + columns] = zero
            continue
        fill(state, stride, one)
        live = inside(rows, columns)
        lane_x, lane_y = load(places, int64(0)), load(places, int64(LANES))
        for pair in range(begin, end):
            i = pair_gaussian[pair]
            at = (pair - begin) % BATCH
            if at == 0:
                ahead = min(end, pair + BATCH)
                look_ahead(splats, pair_gaussian, pair, ahead, x0, y0, places, masks, offsets)
            todo, at = masks[at] & live, at * 2 * LANES
            l11, l12, l22 = exponent(splats, i)
            top = splats[i, POWER] * float32(2.0 * SQUARES) + faintest
            at_p, at_q = fma(lane_x, l11, lane_y * l12), lane_y * l22
            f0, f1 = splats[i, FEAT], splats[i, FEAT + 1]
            f2, f3 = splats[i, FEAT + 2], splats[i, FEAT + 3]
            met = uint32(0)
            while todo != 0:
                k = lowest_bit(todo)
                todo &= todo - uint32(1)
                place = k * stride
                p, q = at_p + offsets[at + k], at_q + offsets[at + LANES + k]
                y = fma(negative(q), q, fma(negative(p), p, top))
                alpha = exp2(y)
                alpha = select(wide(alpha_max) > alpha, alpha, alpha_max)
                t = load(state, place)
                visible = (y >= faintest) & (t > zero)
                alpha = select(y >= faintest, alpha, zero)
                met |= uint32(bits(visible) != 0) << uint32(
                    k
                )  # one that stops here may give nothing, but counts
                nt = fma(negative(t), alpha, t)
                on = nt > t_min
                w = select(on, t * alpha, zero)
                store(state, place, select(on, nt, negative(magnitude(t))))
                place += LANES
                store(state, place, fma(w, f0, load(state, place)))
                place += LANES
                store(state, place, fma(w, f1, load(state, place)))
                place += LANES
                store(state, place, fma(w, f2, load(state, place)))
                place += LANES
                store(state, place, fma(w, f3, load(state, place)))
                if bits(on) == 0:
                    live &= ~(uint32(1) << uint32(k))
            reached[pair] = met
            if live == 0:
                for rest in range(pair + 1, end):
                    reached[rest] = uint32(0)
                break
        for r in range(rows):
            for j in range(columns):
                at = pixel(r, j, stride)
                transmittance[y0 + r, x0 + j] = abs(state[at])
                for k in range(FEATURES):
                    image[y0 + r, x0 + j, k] = state[(1 + k) * LANES + at]


@kernel()
def _backward_tiles(order, counter, tables, frame, splats, pictures, v_pairs, alpha_min):
    tile_start, pair_gaussian, places, reached = tables
    width, height = frame
    image, transmittance, v_image, v_transmittance = pictures
    n_x = (width + TILE - 1) // TILE
    one, half, zero = float32(1.0), float32(0.5), float32(0.0)
    alpha_max, t_min = float32(ALPHA_MAX), float32(T_MIN)
    faintest = float32(math.log2(alpha_min))
    # planes: transmittance, what is still to come (as seen by the loss), gradient by the features
    stride = (2 + FEATURES) * LANES
    state = aligned(BLOCKS * stride)
    offsets = aligned(BATCH * 2 * LANES)
    masks = np.empty(BATCH, np.uint32)
    while True:
        item = fetch_add(counter)
        if item >= len(order):
            break
        tile = order[item]
        begin, end = tile_start[tile], tile_start[tile + 1]
        if begin == end:
            continue
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        rows, columns = min(TILE, height - y0), min(TILE, width - x0)
        if rows < TILE or columns < TILE:
            fill(state, stride, -one)  # outside the image: stopped from the start
        for r in range(rows):
            for j in range(columns):
                at = pixel(r, j, stride)
                to_come = v_transmittance[y0 + r, x0 + j] * transmittance[y0 + r, x0 + j]
                for k in range(FEATURES):
                    g = v_image[y0 + r, x0 + j, k]
                    state[(2 + k) * LANES + at] = g
                    to_come += g * image[y0 + r, x0 + j, k]
                state[at] = one
                state[LANES + at] = to_come
        live = inside(rows, columns)
        lane_x, lane_y = load(places, int64(0)), load(places, int64(LANES))
        for pair in range(begin, end):
            i = pair_gaussian[pair]
            nothing = wide(zero)
            s, sx, sy, sxx, sxy = nothing, nothing, nothing, nothing, nothing
            syy, h0, h1, h2, h3 = nothing, nothing, nothing, nothing, nothing
            at = (pair - begin) % BATCH
            if at == 0:
                ahead = min(end, pair + BATCH)
                look_ahead(splats, pair_gaussian, pair, ahead, x0, y0, places, masks, offsets)
            todo, at = reached[pair] & masks[at] & live, at * 2 * LANES
            l11, l12, l22 = exponent(splats, i)
            top = splats[i, POWER] * float32(2.0 * SQUARES) + faintest
            at_p, at_q = fma(lane_x, l11, lane_y * l12), lane_y * l22
            at_x = lane_x + (float32(x0) - splats[i, MX])
            at_y = lane_y + (float32(y0) - splats[i, MY])
            f0, f1 = splats[i, FEAT], splats[i, FEAT + 1]
            f2, f3 = splats[i, FEAT + 2], splats[i, FEAT + 3]
            while todo != 0:
                k = lowest_bit(todo)
                todo &= todo - uint32(1)
                place = k * stride
                p, q = at_p + offsets[at + k], at_q + offsets[at + LANES + k]
                y = fma(negative(q), q, fma(negative(p), p, top))
                raw = exp2(y)
                free = wide(alpha_max) > raw
                alpha = select(free, raw, alpha_max)
                alpha = select(y >= faintest, alpha, zero)
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
                dx, dy = at_x + places[2 * LANES + k], at_y + places[3 * LANES + k]
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
            store_ten(v_pairs, int64(pair) * _GRAD, sums)
            if live == 0:
                for rest in range((pair + 1) * _GRAD, end * _GRAD):
                    v_pairs[rest] = zero
                break


@kernel()
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


@kernel(parallel=True)
def _forward(workers, order, counter, tables, frame, splats, image, transmittance, alpha_min):
    for _ in prange(workers):
        _forward_tiles(order, counter, tables, frame, splats, image, transmittance, alpha_min)


@kernel(parallel=True)
def _backward(workers, order, counter, tables, frame, splats, pictures, v_pairs, alpha_min):
    for _ in prange(workers):
        _backward_tiles(order, counter, tables, frame, splats, pictures, v_pairs, alpha_min)


def work(tile_start: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Number of workers, tiles in the order in which they are taken, and the common counter."""
    return get_num_threads(), _longest_first(tile_start), np.zeros(1, np.int64)


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
    tables, frame = (tile_start, pair_gaussian, PLACES, reached), (width, height)
    _forward(*work(tile_start), tables, frame, splats, image, transmittance, alpha_min)


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
    """Gradient of every (tile, Gaussian) pair, to `v_pairs` [P, FEAT + FEATURES], in the columns of `splats`.

    v_image [H, W, FEATURES] and v_transmittance [H, W] are the loss's gradients by what blend_forward wrote. With
    its `reached`, a sixteenth less time: blocks that only look as if the ellipse reached them are skipped.
    """
    if reached is None:
        reached = np.full(len(pair_gaussian), (1 << BLOCKS) - 1, np.uint32)
    tables, frame = (tile_start, pair_gaussian, PLACES, reached), (width, height)
    pictures = (image, transmittance, v_image, v_transmittance)
    _backward(*work(tile_start), tables, frame, splats, pictures, v_pairs.reshape(-1), alpha_min)
