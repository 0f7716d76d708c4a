"""Blending linearised at rest: JVP, VJP and the Gauss-Newton product JᵀWJ, several right-hand sides at once.

Weights and their derivatives by the exponent do not depend on the right-hand side: they are computed once for each
block of pixels and Gaussian; every right-hand side then takes a second, short loop over the blocks. Opacity is fixed.
Blocks, tiles and threads as in `tiles.py`. Pairs are visited in the blocks in which `blend_forward` saw them.

With α = o·2^-(p²+q²) and r = -d(exponent), a contribution's weight w = T α changes by T α r + w·(dT/T), and dT/T by
-r α / (1 - α). The quotient dT/T is carried along, so that both directions need the same three numbers.

Conjugate gradients need JᵀWJ and never the picture in between. `blend_normal` keeps a tile in the cache: weights and
slopes of its contributions are computed once and kept for the VJP, which goes from far to near, so that what lies
behind a contribution has been summed already.
"""

# mypy: disable-error-code="call-arg, var-annotated, operator"
# an intrinsic has one argument more than its calls: the typing context

import math

import numpy as np
from numba import float32, int64, prange

from tg4mm.fit.rasterize.kernels.binning import Bins
from tg4mm.fit.rasterize.kernels.block_culling import BATCH, KEPT, batch_room, load_batch, weights
from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel
from tg4mm.fit.rasterize.kernels.layout import CA, CB, CC, FEAT, MX, MY, SPLAT_WIDTH, TILE
from tg4mm.fit.rasterize.kernels.tiles import BLOCKS, TABLE, aligned, constants, fill, inside, pixel, work
from tg4mm.fit.rasterize.simd.lanes import lane_sums_of_eight, store_eight
from tg4mm.fit.rasterize.simd.memory import address, fetch_add, keep, load_pixels, number, store
from tg4mm.fit.rasterize.simd.vector import PIXELS, broadcast_pixels, fma, popcount

COLUMNS = np.array([MX, MY, CA, CB, CC, FEAT, FEAT + 1, FEAT + 2])  # the columns of the splats in a change
_WIDTH = 8  # their number
# Planes of the state for each right-hand side. Forward: dT/T and the picture's change. Backward: the light behind and
# the gradient by three features.
_CHANGE = 4


@inlined
def _splat(splats, i):
    """Conic and colour of Gaussian i."""
    row = int64(i) * SPLAT_WIDTH
    conic = number(splats, row + CA), number(splats, row + CB), number(splats, row + CC)
    return conic, (number(splats, row + FEAT), number(splats, row + FEAT + 1), number(splats, row + FEAT + 2))


@inlined
def _jvp_pair(conic, colour, d_splats, at, plane, blocks, found, kept, state):
    """Add the effect of one change, at `at` of d_splats, on the kept `blocks` (from, to) of a Gaussian."""
    (a, b, c), (f0, f1, f2), half = conic, colour, float32(0.5)
    d0, d1 = number(d_splats, at), number(d_splats, at + 1)
    e0, e1, e2 = number(d_splats, at + 5), number(d_splats, at + 6), number(d_splats, at + 7)
    # minus the change of the exponent: (xx dx + xy dy + x) dx + (yy dy + y) dy
    xx, xy, yy = -half * number(d_splats, at + 2), -number(d_splats, at + 3), -half * number(d_splats, at + 4)
    x, y = a * d0 + b * d1, b * d0 + c * d1
    for m in range(blocks[0], blocks[1]):
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


@kernel()
def _jvp_tiles(order, counter, tables, frame, splats, d_splats, white, d_images, alpha_min):
    tile_start, pair_gaussian, table, reached = tables
    width, height = frame
    n_changes = len(d_images)
    n_x = (width + TILE - 1) // TILE
    zero = float32(0.0)
    faintest = float32(math.log2(alpha_min))
    # planes: transmittance, then of every change dT/T and three features
    stride = (1 + _CHANGE * n_changes) * PIXELS
    held, state = constants(table), aligned(BLOCKS * stride)
    masks, planes, kept, found = batch_room()
    batch = masks, address(planes), kept, found
    flat, changes = splats.reshape(-1), d_splats.reshape(-1)
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
                load_batch(splats, pair_gaussian, reached, pair, last, end, x0, y0, faintest, held, batch)
            n, live = weights(splats, i, at, live, x0, y0, faintest, table, held, state, stride, batch)
            conic, colour = _splat(flat, i)
            for change in range(n_changes if n > 0 else 0):
                plane, source = (1 + _CHANGE * change) * PIXELS, (int64(i) * n_changes + change) * _WIDTH
                _jvp_pair(conic, colour, changes, source, plane, (int64(0), n), found, kept, state)
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
    tile_start, pair_gaussian, table, reached = tables
    width, height = frame
    image, transmittance = pictures
    n_changes = len(v_images)
    n_x = (width + TILE - 1) // TILE
    half, zero = float32(0.5), float32(0.0)
    faintest = float32(math.log2(alpha_min))
    # planes: transmittance, then of every right-hand side what is still to come and the gradient by three features
    stride = (1 + _CHANGE * n_changes) * PIXELS
    held, state = constants(table), aligned(BLOCKS * stride)
    masks, planes, kept, found = batch_room()
    batch = masks, address(planes), kept, found
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
                load_batch(splats, pair_gaussian, reached, pair, last, end, x0, y0, faintest, held, batch)
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


@inlined
def _vjp_pair(conic, colour, v_pairs, at, plane, blocks, found, kept, state):
    """Write the cotangent of a Gaussian in one tile at `at` of v_pairs, and add the Gaussian to the light behind."""
    (a, b, c), (f0, f1, f2), half = conic, colour, float32(0.5)
    nothing = broadcast_pixels(float32(0.0))
    sx, sy, sxx, sxy, syy = nothing, nothing, nothing, nothing, nothing
    h0, h1, h2 = nothing, nothing, nothing
    for m in range(blocks[0], blocks[1]):
        place, source = found[m] + plane, m * KEPT
        w, behind = load_pixels(kept, source), load_pixels(state, place)
        g0, g1 = load_pixels(state, place + PIXELS), load_pixels(state, place + 2 * PIXELS)
        g2 = load_pixels(state, place + 3 * PIXELS)
        light = fma(g2, f2, fma(g1, f1, g0 * f0))
        v = fma(load_pixels(kept, source + PIXELS), light, -(load_pixels(kept, source + 2 * PIXELS) * behind))
        store(state, place, fma(w, light, behind))
        dx, dy = load_pixels(kept, source + 3 * PIXELS), load_pixels(kept, source + 4 * PIXELS)
        vx, vy = v * dx, v * dy
        sx, sy = sx + vx, sy + vy
        sxx, sxy, syy = fma(vx, dx, sxx), fma(vx, dy, sxy), fma(vy, dy, syy)
        h0, h1, h2 = fma(w, g0, h0), fma(w, g1, h1), fma(w, g2, h2)
    sums = lane_sums_of_eight(
        fma(sx, a, sy * b), fma(sx, b, sy * c), sxx * -half, -sxy, syy * -half, h0, h1, h2
    )
    store_eight(v_pairs, at, sums)


@inlined
def _turn_round(state, stride, n_changes, white, counts):
    """Turn changes of the picture into gradients by the pixels' weights; behind all Gaussians is the background."""
    for k in range(BLOCKS):
        first = int64(k) * stride
        end, count = abs(load_pixels(state, first)) * white, load_pixels(counts, k * PIXELS)
        for change in range(n_changes):
            place = first + (1 + _CHANGE * change) * PIXELS
            shift = end * load_pixels(state, place)
            g0 = count * (load_pixels(state, place + PIXELS) + shift)
            g1 = count * (load_pixels(state, place + 2 * PIXELS) + shift)
            g2 = count * (load_pixels(state, place + 3 * PIXELS) + shift)
            store(state, place, end * (g0 + g1 + g2))
            store(state, place + PIXELS, g0)
            store(state, place + 2 * PIXELS, g1)
            store(state, place + 3 * PIXELS, g2)


@inlined
def _weigh(pixels, y0, x0, rows, columns, counts):
    """The weights of a tile's pixels, block by block; 0 outside the picture."""
    counts[:] = float32(0.0)
    for r in range(rows):
        for j in range(columns):
            counts[pixel(r, j, PIXELS)] = pixels[y0 + r, x0 + j]


@kernel()
def _normal_tiles(
    order, counter, tables, most, splats, d_splats, n_changes, white, pixels, v_pairs, alpha_min
):
    tile_start, pair_gaussian, table, reached = tables
    height, width = pixels.shape
    n_x = (width + TILE - 1) // TILE
    faintest = float32(math.log2(alpha_min))
    stride = (1 + _CHANGE * n_changes) * PIXELS
    held, state, counts = constants(table), aligned(BLOCKS * stride), aligned(BLOCKS * PIXELS)
    masks, planes, kept, found = batch_room(most[0])
    batch = masks, address(planes), kept, found
    upto = np.empty(most[1] + 1, np.int64)  # of the pairs of a tile: where the kept blocks of each end
    flat, changes, gradients = splats.reshape(-1), d_splats.reshape(-1), v_pairs.reshape(-1)
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
        if not _counts(pixels, y0, x0, rows, columns):
            gradients[begin * n_changes * _WIDTH : end * n_changes * _WIDTH] = float32(0.0)
            continue
        fill(state, stride, float32(1.0))
        live, filled = inside(rows, columns), int64(0)
        upto[0] = 0
        for pair in range(begin, end):
            i = pair_gaussian[pair]
            at = (pair - begin) % BATCH
            if at == 0:
                last = min(end, pair + BATCH)
                load_batch(splats, pair_gaussian, reached, pair, last, end, x0, y0, faintest, held, batch)
            before = filled
            filled, live = weights(
                splats, i, at, live, x0, y0, faintest, table, held, state, stride, batch, filled
            )
            upto[pair - begin + 1] = filled
            blocks = before, filled
            conic, colour = _splat(flat, i)
            for change in range(n_changes if before < filled else 0):
                plane, source = (1 + _CHANGE * change) * PIXELS, (int64(i) * n_changes + change) * _WIDTH
                _jvp_pair(conic, colour, changes, source, plane, blocks, found, kept, state)
        _weigh(pixels, y0, x0, rows, columns, counts)
        _turn_round(state, stride, n_changes, white, counts)
        for back in range(end - begin):
            pair = int64(end - 1 - back)
            conic, colour = _splat(flat, pair_gaussian[pair])
            blocks = upto[pair - begin], upto[pair - begin + 1]
            for change in range(n_changes):
                plane, to = (1 + _CHANGE * change) * PIXELS, (pair * n_changes + change) * _WIDTH
                _vjp_pair(conic, colour, gradients, to, plane, blocks, found, kept, state)
    keep(planes)


@kernel()
def _counts(pixels, y0, x0, rows, columns):
    """Whether any pixel of a tile has a weight."""
    for y in range(y0, y0 + rows):
        for x in range(x0, x0 + columns):
            if pixels[y, x] != float32(0.0):
                return True
    return False


@kernel(parallel=True)
def _jvp(workers, order, counter, tables, frame, splats, d_splats, white, d_images, alpha_min):
    for _ in prange(workers):
        _jvp_tiles(order, counter, tables, frame, splats, d_splats, white, d_images, alpha_min)


@kernel(parallel=True)
def _vjp(workers, order, counter, tables, frame, splats, pictures, white, v_images, v_pairs, alpha_min):
    for _ in prange(workers):
        _vjp_tiles(order, counter, tables, frame, splats, pictures, white, v_images, v_pairs, alpha_min)


@kernel(parallel=True)
def _normal(
    workers, order, counter, tables, most, splats, d_splats, n_changes, white, pixels, v_pairs, alpha_min
):
    for _ in prange(workers):
        _normal_tiles(
            order, counter, tables, most, splats, d_splats, n_changes, white, pixels, v_pairs, alpha_min
        )


@kernel()
def most_blocks(tile_start, reached):
    """Return the most blocks in any tile that the pairs of one reach, at least 1, and the most pairs."""
    most, longest = 1, 1
    for tile in range(len(tile_start) - 1):
        count = 0
        for pair in range(tile_start[tile], tile_start[tile + 1]):
            count += int64(popcount(reached[pair]))
        most, longest = max(most, count), max(longest, tile_start[tile + 1] - tile_start[tile])
    return most, longest


def _tables(bins: Bins) -> tuple[np.ndarray, ...]:
    return bins.tile_start, bins.pair_gaussian, TABLE, bins.reached


def blend_tangents(
    splats: np.ndarray, d_splats: np.ndarray, bins: Bins, white: float, d_images: np.ndarray, alpha_min: float
) -> None:
    """Forward mode: how the picture over `white` changes when `splats` moves along each of R changes.

    d_splats [N, R, 8] has the columns COLUMNS; d_images [R, H, W, 3] is written. `bins.reached` is that of
    `blend_forward` with the same alpha_min.
    """
    height, width = d_images.shape[1:3]
    _jvp(
        *work(bins.tile_start), _tables(bins), (width, height), splats, d_splats, np.float32(white), d_images,
        alpha_min,
    )  # fmt: skip


def blend_cotangents(
    splats: np.ndarray,
    bins: Bins,
    white: float,
    image: np.ndarray,
    transmittance: np.ndarray,
    v_images: np.ndarray,
    v_pairs: np.ndarray,
    alpha_min: float,
) -> None:
    """Transpose of `blend_tangents`: cotangents of the (tile, Gaussian) pairs for R picture gradients [R, H, W, 3].

    v_pairs [P, R, 8] is written, in the columns COLUMNS. image and transmittance are those of `blend_forward`.
    """
    height, width = v_images.shape[1:3]
    _vjp(
        *work(bins.tile_start), _tables(bins), (width, height), splats, (image, transmittance),
        np.float32(white), v_images, v_pairs.reshape(-1), alpha_min,
    )  # fmt: skip


def blend_normal(
    splats: np.ndarray,
    d_splats: np.ndarray,
    bins: Bins,
    most: tuple[int, int],
    white: float,
    pixels: np.ndarray,
    v_pairs: np.ndarray,
    alpha_min: float,
) -> None:
    """`blend_tangents`, the pictures times `pixels` [H, W], and `blend_cotangents`, of R changes, in one pass.

    d_splats [N, R, 8] and v_pairs [P, R, 8] as there; most: of `most_blocks`.
    """
    _normal(
        *work(bins.tile_start), _tables(bins), most, splats, d_splats, d_splats.shape[1], np.float32(white),
        pixels, v_pairs, alpha_min,
    )  # fmt: skip
