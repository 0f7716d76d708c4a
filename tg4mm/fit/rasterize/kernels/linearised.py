"""Blending linearised at rest: JVP, VJP and the Gauss-Newton product JᵀWJ, several right-hand sides at once.

Weights and their derivatives by the exponent do not depend on the right-hand side: they are computed once for each
block of pixels and Gaussian; every right-hand side then takes a second, short loop over the blocks. Opacity is fixed.
Blocks, tiles and threads as in `tiles.py`. Pairs are visited in the blocks in which `blend_forward` saw them.

With α = o·2^-(p²+q²) and r = -d(exponent), a contribution's weight w = T α changes by T α r + w·(dT/T), and dT/T by
-r α / (1 - α). The quotient dT/T is carried along, so that both directions need the same three numbers.

The VJP visits a tile's pairs from far to near, so that the light behind a contribution has been summed already, with
the weights and slopes that the way there has kept. Conjugate gradients need JᵀWJ and never the picture in between:
`blend_normal` goes both ways in a tile while it is in the cache.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import float32, int64

from tg4mm.fit.rasterize.kernels.binning import Bins
from tg4mm.fit.rasterize.kernels.block_culling import BATCH, KEPT, batch_room, load_batch, weights
from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel, shared
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
_JVP, _VJP, _NORMAL = 0, 1, 2
_NO_PIXELS = np.empty((0, 0), np.float32)
_NO_CHANGES, _NO_PICTURES = np.empty((0, 0, _WIDTH), np.float32), np.empty((0, 0, 0, 3), np.float32)


class BlendedView(NamedTuple):
    """A view at rest for the linearised passes; `bins.reached` is that of `blend_forward` with the same alpha_min."""

    splats: np.ndarray  # [N, SPLAT_WIDTH]
    bins: Bins
    most: tuple[int, int]  # largest numbers of blocks and pairs of a tile, of `most_blocks`
    white: float  # background
    alpha_min: float


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


@kernel
def _counts(pixels, y0, x0, rows, columns):
    """Return whether any pixel of a tile has a weight."""
    for y in range(y0, y0 + rows):
        for x in range(x0, x0 + columns):
            if pixels[y, x] != float32(0.0):
                return True
    return False


@inlined
def _load_gradients(v_images, white, y0, x0, rows, columns, stride, state):
    """Read a tile of the gradients by the picture into the state; behind all Gaussians is the background."""
    for r in range(rows):
        for j in range(columns):
            at = pixel(r, j, stride)
            for change in range(len(v_images)):
                plane = (1 + _CHANGE * change) * PIXELS + at
                g0 = v_images[change, y0 + r, x0 + j, 0]
                g1 = v_images[change, y0 + r, x0 + j, 1]
                g2 = v_images[change, y0 + r, x0 + j, 2]
                state[plane] = white * abs(state[at]) * (g0 + g1 + g2)
                state[plane + PIXELS], state[plane + 2 * PIXELS], state[plane + 3 * PIXELS] = g0, g1, g2


@inlined
def _write_changes(state, white, y0, x0, rows, columns, stride, d_images):
    """Write a tile of the picture's changes, with what shows of the background."""
    for change in range(len(d_images)):
        plane = (1 + _CHANGE * change) * PIXELS
        for r in range(rows):
            for j in range(columns):
                at = pixel(r, j, stride)
                behind = white * abs(state[at]) * state[plane + at]
                for k in range(3):
                    d_images[change, y0 + r, x0 + j, k] = behind + state[plane + (1 + k) * PIXELS + at]


@shared
def _tiles(_, workers, order, counter, tables, most, job, frame, splats, n_changes, white, arrays, alpha_min):
    tile_start, pair_gaussian, table, reached = tables
    d_splats, pixels, d_images, v_images, v_pairs = arrays
    height, width = frame
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
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        rows, columns = min(TILE, height - y0), min(TILE, width - x0)
        if begin == end:
            if job == _JVP:
                d_images[:, y0 : y0 + rows, x0 : x0 + columns] = float32(0.0)
            continue
        if job == _NORMAL and not _counts(pixels, y0, x0, rows, columns):
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
            before = int64(0) if job == _JVP else filled  # kept for the way back
            filled, live = weights(
                splats, i, at, live, x0, y0, faintest, table, held, state, stride, batch, before
            )
            upto[pair - begin + 1] = filled
            if job != _VJP and before < filled:
                conic, colour = _splat(flat, i)
                for change in range(n_changes):
                    plane, source = (1 + _CHANGE * change) * PIXELS, (int64(i) * n_changes + change) * _WIDTH
                    _jvp_pair(conic, colour, changes, source, plane, (before, filled), found, kept, state)
        if job == _JVP:
            _write_changes(state, white, y0, x0, rows, columns, stride, d_images)
            continue
        if job == _NORMAL:
            _weigh(pixels, y0, x0, rows, columns, counts)
            _turn_round(state, stride, n_changes, white, counts)
        else:
            _load_gradients(v_images, white, y0, x0, rows, columns, stride, state)
        for back in range(end - begin):
            pair = int64(end - 1 - back)
            conic, colour = _splat(flat, pair_gaussian[pair])
            blocks = upto[pair - begin], upto[pair - begin + 1]
            for change in range(n_changes):
                plane, to = (1 + _CHANGE * change) * PIXELS, (pair * n_changes + change) * _WIDTH
                _vjp_pair(conic, colour, gradients, to, plane, blocks, found, kept, state)
    keep(planes)


@kernel
def most_blocks(tile_start, reached):
    """Return the most blocks in any tile that the pairs of one reach, at least 1, and the most pairs."""
    most, longest = 1, 1
    for tile in range(len(tile_start) - 1):
        count = 0
        for pair in range(tile_start[tile], tile_start[tile + 1]):
            count += int64(popcount(reached[pair]))
        most, longest = max(most, count), max(longest, tile_start[tile + 1] - tile_start[tile])
    return most, longest


def blend_tangents(view: BlendedView, d_splats: np.ndarray, d_images: np.ndarray) -> None:
    """Forward mode: how the picture changes when `splats` moves along each of R changes.

    d_splats [N, R, 8] has the columns COLUMNS; d_images [R, H, W, 3] is written.
    """
    arrays = d_splats, _NO_PIXELS, d_images, _NO_PICTURES, _NO_CHANGES
    _run(view, _JVP, d_images.shape[1:3], len(d_images), arrays)


def blend_cotangents(view: BlendedView, v_images: np.ndarray, v_pairs: np.ndarray) -> None:
    """Transpose of `blend_tangents`: cotangents of the (tile, Gaussian) pairs for R picture gradients [R, H, W, 3].

    v_pairs [P, R, 8] is written, in the columns COLUMNS.
    """
    arrays = _NO_CHANGES, _NO_PIXELS, _NO_PICTURES, v_images, v_pairs
    _run(view, _VJP, v_images.shape[1:3], len(v_images), arrays)


def blend_normal(view: BlendedView, d_splats: np.ndarray, pixels: np.ndarray, v_pairs: np.ndarray) -> None:
    """`blend_tangents`, the pictures times `pixels` [H, W], and `blend_cotangents`, in one pass.

    d_splats [N, R, 8] and v_pairs [P, R, 8] as there.
    """
    arrays = d_splats, pixels, _NO_PICTURES, _NO_PICTURES, v_pairs
    _run(view, _NORMAL, pixels.shape, d_splats.shape[1], arrays)


def _run(
    view: BlendedView, job: int, size: tuple[int, ...], n_changes: int, arrays: tuple[np.ndarray, ...]
) -> None:
    bins = view.bins
    _tiles(
        *work(bins.tile_start), (bins.tile_start, bins.pair_gaussian, TABLE, bins.reached), view.most, job, size,
        view.splats, n_changes, np.float32(view.white), arrays, view.alpha_min,
    )  # fmt: skip
