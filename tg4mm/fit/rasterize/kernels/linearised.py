"""JVP and VJP of blending at rest, several tangents or cotangents at once.

What does not depend on the tangent (weights, and derivatives by the exponent) is computed once for each block of pixels
and Gaussian; every tangent, or cotangent, then takes a second, short loop over the blocks.
Opacity is held fixed. Blocks, tiles and threads as in `tiles.py`.

With α = o·2^-(p²+q²) and r = -d(exponent), a contribution's weight w = T α changes by T α r + w·(dT/T), and dT/T by
-r α / (1 - α). The quotient dT/T is what is carried along, so that both directions need the same three numbers.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import math

import numpy as np
from numba import float32, int64, prange

from tg4mm.fit.rasterize.kernels.block_culling import BATCH, KEPT, batch_room, look_at_all, weights
from tg4mm.fit.rasterize.kernels.compiled import kernel
from tg4mm.fit.rasterize.kernels.layout import CA, CB, CC, FEAT, MX, MY, TILE
from tg4mm.fit.rasterize.kernels.tiles import BLOCKS, TABLE, aligned, constants, fill, inside, pixel, work
from tg4mm.fit.rasterize.simd.lanes import lane_sums_of_eight, store_eight
from tg4mm.fit.rasterize.simd.memory import address, fetch_add, keep, load_pixels, store
from tg4mm.fit.rasterize.simd.vector import PIXELS, broadcast_pixels, fma

COLUMNS = np.array([MX, MY, CA, CB, CC, FEAT, FEAT + 1, FEAT + 2])  # of the splats: what a change has
_WIDTH = 8  # how many they are
_CHANGE = 4  # planes of the state for each change


@kernel()
def _jvp_tiles(order, counter, tables, frame, splats, d_splats, white, d_images, alpha_min):
    tile_start, pair_gaussian, table = tables
    width, height = frame
    n_changes = len(d_images)
    n_x = (width + TILE - 1) // TILE
    half, zero = float32(0.5), float32(0.0)
    faintest = float32(math.log2(alpha_min))
    # planes: transmittance, then of every change dT/T and three features
    stride = (1 + _CHANGE * n_changes) * PIXELS
    held, state = constants(table), aligned(BLOCKS * stride)
    masks, words, planes, kept, found = batch_room()
    batch = masks, words, address(planes), kept, found
    while True:
        item = fetch_add(counter)
        if item >= len(order):
            break
        tile = order[item]
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        rows, columns = min(TILE, height - y0), min(TILE, width - x0)
        begin, end = tile_start[tile], tile_start[tile + 1]
        if begin == end:
            d_images[:, y0 : y0 + rows, x0 : x0 + columns] = zero
            continue
        fill(state, stride, float32(1.0))
        live = inside(rows, columns)
        for pair in range(begin, end):
            i = pair_gaussian[pair]
            at = (pair - begin) % BATCH
            if at == 0:
                last = min(end, pair + BATCH)
                look_at_all(splats, pair_gaussian, pair, last, end, x0, y0, faintest, held, batch)
            n, live = weights(splats, i, at, live, x0, y0, faintest, table, held, state, stride, batch)
            a, b, c = splats[i, CA], splats[i, CB], splats[i, CC]
            f0, f1, f2 = splats[i, FEAT], splats[i, FEAT + 1], splats[i, FEAT + 2]
            for change in range(n_changes if n > 0 else 0):
                d = d_splats[i, change]
                e0, e1, e2 = d[5], d[6], d[7]
                # minus the change of the exponent: (xx dx + xy dy + x) dx + (yy dy + y) dy
                xx, xy, yy = -half * d[2], -d[3], -half * d[4]
                x, y = a * d[0] + b * d[1], b * d[0] + c * d[1]
                plane = (1 + _CHANGE * change) * PIXELS
                for m in range(n):
                    place, source = found[m] + plane, m * KEPT
                    w, moved = load_pixels(kept, source), load_pixels(kept, source + PIXELS)
                    dx, dy = load_pixels(kept, source + 3 * PIXELS), load_pixels(kept, source + 4 * PIXELS)
                    rise = fma(fma(dy, xy, fma(dx, xx, x)), dx, fma(dy, yy, y) * dy)
                    dt = load_pixels(state, place)
                    dw = fma(w, dt, moved * rise)
                    store(state, place, fma(-load_pixels(kept, source + 2 * PIXELS), rise, dt))
                    place += PIXELS
                    store(state, place, fma(dw, f0, fma(w, e0, load_pixels(state, place))))
                    place += PIXELS
                    store(state, place, fma(dw, f1, fma(w, e1, load_pixels(state, place))))
                    place += PIXELS
                    store(state, place, fma(dw, f2, fma(w, e2, load_pixels(state, place))))
            if live == 0:
                break
        for change in range(n_changes):
            plane = (1 + _CHANGE * change) * PIXELS
            for r in range(rows):
                for j in range(columns):
                    at = pixel(r, j, stride)
                    behind = white * abs(state[at]) * state[plane + at]
                    for k in range(3):
                        d_images[change, y0 + r, x0 + j, k] = behind + state[plane + (1 + k) * PIXELS + at]
    keep(planes)


@kernel()
def _vjp_tiles(order, counter, tables, frame, splats, pictures, white, v_images, v_pairs, alpha_min):
    tile_start, pair_gaussian, table = tables
    width, height = frame
    image, transmittance = pictures
    n_changes = len(v_images)
    n_x = (width + TILE - 1) // TILE
    half, zero = float32(0.5), float32(0.0)
    faintest = float32(math.log2(alpha_min))
    # planes: transmittance, then of every right-hand side what is still to come and the gradient by three features
    stride = (1 + _CHANGE * n_changes) * PIXELS
    held, state = constants(table), aligned(BLOCKS * stride)
    masks, words, planes, kept, found = batch_room()
    batch = masks, words, address(planes), kept, found
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
        fill(state, stride, float32(-1.0))  # outside the image: stopped from the start
        for r in range(rows):
            for j in range(columns):
                at = pixel(r, j, stride)
                state[at] = float32(1.0)
                for change in range(n_changes):
                    plane, to_come = (1 + _CHANGE * change) * PIXELS + at, zero
                    for k in range(3):
                        g = v_images[change, y0 + r, x0 + j, k]
                        state[plane + (1 + k) * PIXELS] = g
                        to_come += g * (image[y0 + r, x0 + j, k] + white * transmittance[y0 + r, x0 + j])
                    state[plane] = to_come
        live = inside(rows, columns)
        for pair in range(begin, end):
            i = pair_gaussian[pair]
            at = (pair - begin) % BATCH
            if at == 0:
                last = min(end, pair + BATCH)
                look_at_all(splats, pair_gaussian, pair, last, end, x0, y0, faintest, held, batch)
            n, live = weights(splats, i, at, live, x0, y0, faintest, table, held, state, stride, batch)
            a, b, c = splats[i, CA], splats[i, CB], splats[i, CC]
            f0, f1, f2 = splats[i, FEAT], splats[i, FEAT + 1], splats[i, FEAT + 2]
            for change in range(n_changes):
                nothing = broadcast_pixels(zero)
                sx, sy, sxx, sxy, syy = nothing, nothing, nothing, nothing, nothing
                h0, h1, h2 = nothing, nothing, nothing
                plane = (1 + _CHANGE * change) * PIXELS
                for m in range(n):
                    place, source = found[m] + plane, m * KEPT
                    w = load_pixels(kept, source)
                    g0, g1 = load_pixels(state, place + PIXELS), load_pixels(state, place + 2 * PIXELS)
                    g2 = load_pixels(state, place + 3 * PIXELS)
                    light = fma(g2, f2, fma(g1, f1, g0 * f0))
                    to_come = fma(-w, light, load_pixels(state, place))
                    store(state, place, to_come)
                    shade = load_pixels(kept, source + 2 * PIXELS) * to_come
                    v = fma(load_pixels(kept, source + PIXELS), light, -shade)
                    dx, dy = load_pixels(kept, source + 3 * PIXELS), load_pixels(kept, source + 4 * PIXELS)
                    vx, vy = v * dx, v * dy
                    sx, sy = sx + vx, sy + vy
                    sxx, sxy, syy = fma(vx, dx, sxx), fma(vx, dy, sxy), fma(vy, dy, syy)
                    h0, h1, h2 = fma(w, g0, h0), fma(w, g1, h1), fma(w, g2, h2)
                sums = lane_sums_of_eight(
                    fma(sx, a, sy * b), fma(sx, b, sy * c), sxx * -half, -sxy, syy * -half, h0, h1, h2
                )
                store_eight(v_pairs, (int64(pair) * n_changes + change) * _WIDTH, sums)
            if live == 0:
                for rest in range((pair + 1) * n_changes * _WIDTH, end * n_changes * _WIDTH):
                    v_pairs[rest] = zero
                break
    keep(planes)


@kernel(parallel=True)
def _jvp(workers, order, counter, tables, frame, splats, d_splats, white, d_images, alpha_min):
    for _ in prange(workers):
        _jvp_tiles(order, counter, tables, frame, splats, d_splats, white, d_images, alpha_min)


@kernel(parallel=True)
def _vjp(workers, order, counter, tables, frame, splats, pictures, white, v_images, v_pairs, alpha_min):
    for _ in prange(workers):
        _vjp_tiles(order, counter, tables, frame, splats, pictures, white, v_images, v_pairs, alpha_min)


def blend_tangents(
    splats: np.ndarray,
    d_splats: np.ndarray,
    tile_start: np.ndarray,
    pair_gaussian: np.ndarray,
    white: float,
    d_images: np.ndarray,
    alpha_min: float,
) -> None:
    """Forward mode: how the picture over `white` changes when `splats` moves along each of R changes.

    d_splats [N, R, 8] holds the columns COLUMNS; d_images [R, H, W, 3] is written.
    """
    height, width = d_images.shape[1:3]
    tables = (tile_start, pair_gaussian, TABLE)
    _jvp(*work(tile_start), tables, (width, height), splats, d_splats, np.float32(white), d_images, alpha_min)


def blend_cotangents(
    splats: np.ndarray,
    tile_start: np.ndarray,
    pair_gaussian: np.ndarray,
    white: float,
    image: np.ndarray,
    transmittance: np.ndarray,
    v_images: np.ndarray,
    v_pairs: np.ndarray,
    alpha_min: float,
) -> None:
    """The transpose: what R gradients by the picture over `white` [R, H, W, 3] say of every (tile, Gaussian) pair.

    v_pairs [P, R, 8] is written, in the columns COLUMNS. image and transmittance are those of `blend_forward`.
    """
    height, width = v_images.shape[1:3]
    tables, pictures = (tile_start, pair_gaussian, TABLE), (image, transmittance)
    _vjp(
        *work(tile_start), tables, (width, height), splats, pictures, np.float32(white), v_images,
        v_pairs.reshape(-1), alpha_min,
    )  # fmt: skip
