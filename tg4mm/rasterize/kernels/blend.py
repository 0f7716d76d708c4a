"""Front-to-back compositing of the tile lists, [3DGS] Eq. (3), and its gradient, also front to back.

The gradient of a contribution needs the light that comes from behind it. Instead of walking back to front,
the backward pass starts from the finished image and takes each contribution away as it meets it, so both
passes run the same recurrence and nothing but the image is kept between them. The state of a tile lies in one
array, its planes a constant distance apart: that is what lets the compiler vectorise a row of 16 pixels
without checks.

A pixel that has stopped carries a negative transmittance: -T, of which nothing comes any more.
"""

import math

import numpy as np
from numba import float32, njit, prange

from tg4mm.rasterize.kernels.layout import (
    ALPHA_MAX,
    ALPHA_MIN,
    CA,
    CB,
    CC,
    EY,
    FEAT,
    FEATURES,
    MX,
    MY,
    OP,
    T_MIN,
    TILE,
)
from tg4mm.rasterize.kernels.simd import exp_neg

_AREA = TILE * TILE
_CHECK = 8  # Gaussians between two looks at which rows have stopped


@njit(fastmath=True, inline="always")
def _rows(splats, i, y0, rows):
    """Rows [first, last] of the tile starting at pixel row y0 that the ellipse of Gaussian i reaches."""
    reach = splats[i, EY]
    y = splats[i, MY] - float32(0.5) - float32(y0)
    first = max(math.ceil(y - reach), 0)
    last = min(math.floor(y + reach), rows - 1)
    return first, last


@njit(fastmath=True, inline="always")
def _live_rows(state, live):
    """Mark the rows in which a pixel still takes light; returns how many there are."""
    total = 0
    for r in range(TILE):
        best = float32(-1.0)
        for j in range(TILE):
            best = max(best, state[0, r, j])
        live[r] = best > float32(0.0)
        total += live[r]
    return total


@njit(parallel=True, fastmath=True, cache=True)
def blend_forward(
    splats, tile_start, pair_gaussian, width, height, image, transmittance, alpha_min=ALPHA_MIN
):
    """Composite. `image` [H, W, FEATURES] and `transmittance` [H, W] are written; no background is added."""
    n_x = (width + TILE - 1) // TILE
    n_y = (height + TILE - 1) // TILE
    one, half = float32(1.0), float32(0.5)
    alpha_min, alpha_max, t_min = float32(alpha_min), float32(ALPHA_MAX), float32(T_MIN)
    for tile in prange(n_x * n_y):
        state = np.zeros((1 + FEATURES, TILE, TILE), np.float32)
        state[0] = one
        live = np.ones(TILE, np.uint8)
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        rows, columns = min(TILE, height - y0), min(TILE, width - x0)
        for p in range(tile_start[tile], tile_start[tile + 1]):
            if (p - tile_start[tile]) % _CHECK == _CHECK - 1 and _live_rows(state, live) == 0:
                break
            i = pair_gaussian[p]
            first, last = _rows(splats, i, y0, rows)
            a, b, c, o = splats[i, CA] * half, splats[i, CB], splats[i, CC] * half, splats[i, OP]
            f0, f1 = splats[i, FEAT], splats[i, FEAT + 1]
            f2, f3 = splats[i, FEAT + 2], splats[i, FEAT + 3]
            dx0 = float32(x0) + half - splats[i, MX]
            dy0 = float32(y0) + half - splats[i, MY]
            for r in range(first, last + 1):
                if not live[r]:
                    continue
                dy = dy0 + float32(r)
                bdy, cdy = b * dy, c * dy * dy
                for j in range(TILE):
                    dx = dx0 + float32(j)
                    sigma = max((a * dx + bdy) * dx + cdy, float32(0.0))
                    alpha = min(o * exp_neg(min(sigma, float32(80.0))), alpha_max)
                    alpha = alpha if alpha >= alpha_min else float32(0.0)
                    t = state[0, r, j]
                    nt = t * (one - alpha)
                    w = t * alpha if nt > t_min else float32(0.0)
                    state[0, r, j] = nt if nt > t_min else -abs(t)
                    state[1, r, j] += w * f0
                    state[2, r, j] += w * f1
                    state[3, r, j] += w * f2
                    state[4, r, j] += w * f3
        for r in range(rows):
            for j in range(columns):
                transmittance[y0 + r, x0 + j] = abs(state[0, r, j])
                for k in range(FEATURES):
                    image[y0 + r, x0 + j, k] = state[1 + k, r, j]


@njit(parallel=True, fastmath=True, cache=True)
def blend_backward(
    splats, tile_start, pair_gaussian, width, height, image, transmittance, v_image, v_transmittance, v_pairs,
    alpha_min=ALPHA_MIN,
):  # fmt: skip
    """Gradient of every (tile, Gaussian) pair, to `v_pairs` [P, FEAT + FEATURES], in the columns of `splats`.

    v_image [H, W, FEATURES] and v_transmittance [H, W] are the loss's gradients by what blend_forward wrote.
    """
    n_x = (width + TILE - 1) // TILE
    n_y = (height + TILE - 1) // TILE
    one, half, zero = float32(1.0), float32(0.5), float32(0.0)
    alpha_min, alpha_max, t_min = float32(alpha_min), float32(ALPHA_MAX), float32(T_MIN)
    for tile in prange(n_x * n_y):
        # planes: transmittance, what is still to come (as seen by the loss), gradient by the features
        state = np.zeros((2 + FEATURES, TILE, TILE), np.float32)
        acc = np.zeros((3 + FEATURES, TILE), np.float32)
        live = np.ones(TILE, np.uint8)
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        rows, columns = min(TILE, height - y0), min(TILE, width - x0)
        state[0] = -one  # outside the image: stopped from the start
        for r in range(rows):
            for j in range(columns):
                to_come = v_transmittance[y0 + r, x0 + j] * transmittance[y0 + r, x0 + j]
                for k in range(FEATURES):
                    g = v_image[y0 + r, x0 + j, k]
                    state[2 + k, r, j] = g
                    to_come += g * image[y0 + r, x0 + j, k]
                state[0, r, j] = one
                state[1, r, j] = to_come
        stopped = False
        for p in range(tile_start[tile], tile_start[tile + 1]):
            if (p - tile_start[tile]) % _CHECK == _CHECK - 1 and not stopped:
                stopped = _live_rows(state, live) == 0
            if stopped:
                for k in range(FEAT + FEATURES):
                    v_pairs[p, k] = zero
                continue
            i = pair_gaussian[p]
            first, last = _rows(splats, i, y0, rows)
            a, b, c, o = splats[i, CA] * half, splats[i, CB], splats[i, CC] * half, splats[i, OP]
            f0, f1 = splats[i, FEAT], splats[i, FEAT + 1]
            f2, f3 = splats[i, FEAT + 2], splats[i, FEAT + 3]
            dx0 = float32(x0) + half - splats[i, MX]
            dy0 = float32(y0) + half - splats[i, MY]
            for k in range(3 + FEATURES):
                for j in range(TILE):
                    acc[k, j] = zero
            for r in range(first, last + 1):
                if not live[r]:
                    continue
                dy = dy0 + float32(r)
                bdy, cdy = b * dy, c * dy * dy
                for j in range(TILE):
                    dx = dx0 + float32(j)
                    sigma = max((a * dx + bdy) * dx + cdy, zero)
                    raw = o * exp_neg(min(sigma, float32(80.0)))
                    alpha = min(raw, alpha_max)
                    alpha = alpha if alpha >= alpha_min else zero
                    t = state[0, r, j]
                    nt = t * (one - alpha)
                    on = nt > t_min
                    w = t * alpha if on else zero
                    g0, g1, g2, g3 = state[2, r, j], state[3, r, j], state[4, r, j], state[5, r, j]
                    q = g0 * f0 + g1 * f1 + g2 * f2 + g3 * f3
                    to_come = state[1, r, j] - w * q
                    state[0, r, j] = nt if on else -abs(t)
                    state[1, r, j] = to_come
                    v_alpha = t * q - to_come / (one - alpha)
                    # alpha = o e^(-sigma), so its gradient by -sigma is alpha itself; clamped ones give none
                    v = alpha * v_alpha if on and raw < alpha_max else zero
                    acc[0, j] += v
                    acc[1, j] += v * dy
                    acc[2, j] += v * dy * dy
                    acc[3, j] += w * g0
                    acc[4, j] += w * g1
                    acc[5, j] += w * g2
                    acc[6, j] += w * g3
            s, sx, sy, sxx, sxy, syy = zero, zero, zero, zero, zero, zero
            h0, h1, h2, h3 = zero, zero, zero, zero
            for j in range(TILE):
                dx = dx0 + float32(j)
                s += acc[0, j]
                sx += acc[0, j] * dx
                sxx += acc[0, j] * dx * dx
                sy += acc[1, j]
                sxy += acc[1, j] * dx
                syy += acc[2, j]
                h0 += acc[3, j]
                h1 += acc[4, j]
                h2 += acc[5, j]
                h3 += acc[6, j]
            v_pairs[p, MX] = float32(2.0) * a * sx + b * sy
            v_pairs[p, MY] = b * sx + float32(2.0) * c * sy
            v_pairs[p, CA] = -half * sxx
            v_pairs[p, CB] = -sxy
            v_pairs[p, CC] = -half * syy
            v_pairs[p, OP] = s / o
            v_pairs[p, FEAT] = h0
            v_pairs[p, FEAT + 1] = h1
            v_pairs[p, FEAT + 2] = h2
            v_pairs[p, FEAT + 3] = h3


@njit(parallel=True, fastmath=True, cache=True)
def blend_tangent(splats, d_splats, tile_start, pair_gaussian, width, height, d_image, alpha_min=ALPHA_MIN):
    """Forward mode: how the composite changes when `splats` moves along `d_splats` [N, FEAT + 3].

    d_image [H, W, 4] is written: change of the first three features and of the transmittance. Opacity is held
    fixed. In these columns the exact adjoint of `blend_backward`.
    """
    n_x = (width + TILE - 1) // TILE
    n_y = (height + TILE - 1) // TILE
    one, half, zero = float32(1.0), float32(0.5), float32(0.0)
    alpha_min, alpha_max, t_min = float32(alpha_min), float32(ALPHA_MAX), float32(T_MIN)
    for tile in prange(n_x * n_y):
        # planes: transmittance, its tangent, tangents of three features
        state = np.zeros((5, TILE, TILE), np.float32)
        state[0] = one
        live = np.ones(TILE, np.uint8)
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        rows, columns = min(TILE, height - y0), min(TILE, width - x0)
        for p in range(tile_start[tile], tile_start[tile + 1]):
            if (p - tile_start[tile]) % _CHECK == _CHECK - 1 and _live_rows(state, live) == 0:
                break
            i = pair_gaussian[p]
            first, last = _rows(splats, i, y0, rows)
            a, b, c, o = splats[i, CA] * half, splats[i, CB], splats[i, CC] * half, splats[i, OP]
            f0, f1, f2 = splats[i, FEAT], splats[i, FEAT + 1], splats[i, FEAT + 2]
            e0, e1, e2 = d_splats[i, FEAT], d_splats[i, FEAT + 1], d_splats[i, FEAT + 2]
            ux, uy = d_splats[i, MX], d_splats[i, MY]
            da, db, dc = d_splats[i, CA] * half, d_splats[i, CB], d_splats[i, CC] * half
            dx0 = float32(x0) + half - splats[i, MX]
            dy0 = float32(y0) + half - splats[i, MY]
            for r in range(first, last + 1):
                if not live[r]:
                    continue
                dy = dy0 + float32(r)
                bdy, cdy = b * dy, c * dy * dy
                for j in range(TILE):
                    dx = dx0 + float32(j)
                    sigma = max((a * dx + bdy) * dx + cdy, zero)
                    raw = o * exp_neg(min(sigma, float32(80.0)))
                    alpha = min(raw, alpha_max)
                    alpha = alpha if alpha >= alpha_min else zero
                    t, dt = state[0, r, j], state[1, r, j]
                    nt = t * (one - alpha)
                    on = nt > t_min
                    d_sigma = (da * dx + db * dy) * dx + dc * dy * dy
                    d_sigma -= (float32(2.0) * a * dx + bdy) * ux + (b * dx + float32(2.0) * c * dy) * uy
                    d_alpha = -alpha * d_sigma if raw < alpha_max else zero
                    w = t * alpha if on else zero
                    dw = dt * alpha + t * d_alpha if on else zero
                    state[0, r, j] = nt if on else -abs(t)
                    state[1, r, j] = dt * (one - alpha) - t * d_alpha if on else dt
                    state[2, r, j] += dw * f0 + w * e0
                    state[3, r, j] += dw * f1 + w * e1
                    state[4, r, j] += dw * f2 + w * e2
        for r in range(rows):
            for j in range(columns):
                d_image[y0 + r, x0 + j, 0] = state[2, r, j]
                d_image[y0 + r, x0 + j, 1] = state[3, r, j]
                d_image[y0 + r, x0 + j, 2] = state[4, r, j]
                d_image[y0 + r, x0 + j, 3] = state[1, r, j]
