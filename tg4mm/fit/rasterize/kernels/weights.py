"""Blending weights of a Gaussian's blocks and their derivatives by the exponent, for the linearised picture.

Blocks, tiles and state as in `tiles.py`; `linearised.py` says what the numbers are for.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import numpy as np
from numba import float32, int64, uint32

from tg4mm.fit.rasterize.kernels.block_culling import (
    by_gaussian,
    fill_batch,
    log2_alpha,
    prefetch_gaussians,
    reaching,
    room,
)
from tg4mm.fit.rasterize.kernels.compiled import inlined
from tg4mm.fit.rasterize.kernels.layout import MX, MY
from tg4mm.fit.rasterize.kernels.tiles import BLOCKS, CENTRE_X, CENTRE_Y, aligned, alphas
from tg4mm.fit.rasterize.simd.memory import address, keep, load_pixels, store
from tg4mm.fit.rasterize.simd.vector import PIXELS, ctz, movemask, select

KEPT = 5 * PIXELS  # numbers kept for each block: w, Tα, α/(1 - α), dx, dy
BATCH = 32  # pairs of a batch
_PLANES = room(BATCH)


@inlined
def look_at_all(splats, pair_gaussian, first, last, end, x0, y0, faintest, held, batch):
    """Load, for the pairs first … last, what `weights` needs, and which blocks they may reach."""
    masks, words, at, _, _ = batch
    flat, gaussians = address(splats), address(pair_gaussian)
    fill_batch(flat, gaussians, first, last, end, BATCH, (x0, y0), held[:2], faintest, at, True)
    prefetch_gaussians(flat, gaussians, last, BATCH, end)
    reaching(at, BATCH, int64(0), address(words))
    by_gaussian(address(words), int64(BATCH), address(masks))
    keep(words)
    keep(masks)


@inlined
def look_at_reached(splats, pair_gaussian, reached, first, last, end, x0, y0, faintest, held, batch):
    """`look_at_all` where `blend_forward` has told which blocks are reached."""
    masks, _, at, _, _ = batch
    fill_batch(
        address(splats), address(pair_gaussian), first, last, end, BATCH, (x0, y0), held[:2], faintest, at, False
    )  # fmt: skip
    for n in range(last - first):
        masks[n] = reached[first + n]


@inlined
def batch_room(blocks=BLOCKS):
    """Room for a batch: masks, words and planes of its pairs; for `weights` of so many blocks: `kept` and `found`."""
    masks, words = np.empty(BATCH, np.uint32), np.empty(BLOCKS, np.uint32)
    return masks, words, aligned(_PLANES), aligned(blocks * KEPT), np.empty(blocks, np.int64)


@inlined
def weights(splats, i, n, live, x0, y0, faintest, table, held, state, stride, batch, count=0):
    """What every change needs from the blocks that Gaussian i, n-th of its batch, reaches; and the next transmittance.

    `kept` gets it from block `count` on, and `found` the place of each of these blocks in the state. Returns how many
    are there then, and the blocks still live.
    """
    masks, _, planes, kept, found = batch
    lane_x, lane_y, powers, alpha_max, t_min = held
    one, zero = float32(1.0), float32(0.0)
    at_x = lane_x + (float32(x0) - splats[i, MX])
    at_y = lane_y + (float32(y0) - splats[i, MY])
    todo, count = masks[n] & live, int64(count)
    while todo != 0:
        k = ctz(todo)
        todo &= todo - uint32(1)
        place = k * stride
        y = log2_alpha(planes, BATCH, n, k, lane_y)
        alpha, free, _ = alphas(y, faintest, alpha_max, powers)
        t = load_pixels(state, place)
        w = t * alpha
        nt = t - w
        on = nt > t_min
        w = select(on, w, zero)
        moving = select(on & free, alpha, zero)
        store(state, place, select(on, nt, -abs(t)))
        source = count * KEPT
        store(kept, source, w)
        store(kept, source + PIXELS, t * moving)
        store(kept, source + 2 * PIXELS, moving / (one - alpha))
        store(kept, source + 3 * PIXELS, at_x + table[CENTRE_X + k])
        store(kept, source + 4 * PIXELS, at_y + table[CENTRE_Y + k])
        found[count] = place
        count += int64(movemask(w > zero) != 0)
        if movemask(on) == 0:
            live &= ~(uint32(1) << uint32(k))
    return count, live
