"""What every change of a linearised picture needs of a Gaussian's blocks: weights, and how they answer to the exponent.

Blocks, tiles and state as in `tiles.py`; `linearised.py` says what the numbers are for.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import numpy as np
from numba import float32, int64, njit, uint32

from tg4mm.rasterize.kernels.layout import MX, MY, SPLAT_WIDTH
from tg4mm.rasterize.kernels.memory import load, prefetch, store
from tg4mm.rasterize.kernels.tiles import (
    AHEAD,
    BLOCKS,
    aligned,
    alphas,
    at_centres,
    centres,
    exponent,
    may_reach,
    top_of,
)
from tg4mm.rasterize.kernels.vector import LANES, bits, fma, lowest_bit, magnitude, negative, select

KEPT = 5 * LANES  # numbers kept for each block: w, Tα, α/(1 - α), dx, dy
BATCH = 32  # pairs looked at ahead


@njit(error_model="numpy", inline="always")
def look_ahead(splats, pair_gaussian, first, last, end, x0, y0, table, batch):
    """For the pairs first … last: which blocks may be reached, and p and q at the blocks' centres.

    Ahead, so that the branches of the loop over blocks, which depend on it, do not wait for it.
    """
    masks, offsets, _, _ = batch
    block_x, block_y = centres(table, x0, y0)
    for n in range(last - first):
        prefetch(splats, int64(pair_gaussian[min(first + n + AHEAD, end - 1)]))
        row = int64(pair_gaussian[first + n]) * SPLAT_WIDTH
        p, q, dx = at_centres(splats, row, block_x, block_y)
        store(offsets, n * 2 * LANES, p)
        store(offsets, n * 2 * LANES + LANES, q)
        masks[n] = bits(may_reach(splats, row, p, q, dx))


@njit(error_model="numpy", inline="always")
def look_ahead_of_reached(splats, pair_gaussian, reached, first, last, end, x0, y0, table, batch):
    """`look_ahead` where `blend_forward` has told which blocks are reached."""
    masks, offsets, _, _ = batch
    block_x, block_y = centres(table, x0, y0)
    for n in range(last - first):
        prefetch(splats, int64(pair_gaussian[min(first + n + AHEAD, end - 1)]))
        p, q, _ = at_centres(splats, int64(pair_gaussian[first + n]) * SPLAT_WIDTH, block_x, block_y)
        store(offsets, n * 2 * LANES, p)
        store(offsets, n * 2 * LANES + LANES, q)
        masks[n] = reached[first + n]


@njit(inline="always")
def batch_room():
    """Room for `look_ahead`, and for `weights`: `kept` and `found`."""
    return (
        np.empty(BATCH, np.uint32), aligned(BATCH * 2 * LANES), aligned(BLOCKS * KEPT),
        np.empty(BLOCKS, np.int64),
    )  # fmt: skip


@njit(error_model="numpy", inline="always")
def weights(splats, i, n, live, x0, y0, faintest, table, held, state, stride, batch, count=0):
    """What every change needs from the blocks that Gaussian i, n-th of its batch, reaches; and the next transmittance.

    `kept` gets it from block `count` on, and `found` the place of each of these blocks in the state. Returns how many
    are there then, and the blocks still live.
    """
    masks, offsets, kept, found = batch
    lane_x, lane_y, powers, alpha_max, t_min = held
    one, zero = float32(1.0), float32(0.0)
    l11, l12, l22 = exponent(splats, int64(i) * SPLAT_WIDTH)
    top = top_of(splats, int64(i) * SPLAT_WIDTH, faintest)
    at_p, at_q = fma(lane_x, l11, lane_y * l12), lane_y * l22
    at_x = lane_x + (float32(x0) - splats[i, MX])
    at_y = lane_y + (float32(y0) - splats[i, MY])
    todo, at, count = masks[n] & live, n * 2 * LANES, int64(count)
    while todo != 0:
        k = lowest_bit(todo)
        todo &= todo - uint32(1)
        place = k * stride
        p, q = at_p + offsets[at + k], at_q + offsets[at + LANES + k]
        y = fma(negative(q), q, fma(negative(p), p, top))
        alpha, free, _ = alphas(y, faintest, alpha_max, powers)
        t = load(state, place)
        w = t * alpha
        nt = t - w
        on = nt > t_min
        w = select(on, w, zero)
        moving = select(on & free, alpha, zero)
        store(state, place, select(on, nt, negative(magnitude(t))))
        source = count * KEPT
        store(kept, source, w)
        store(kept, source + LANES, t * moving)
        store(kept, source + 2 * LANES, moving / (one - alpha))
        store(kept, source + 3 * LANES, at_x + table[2 * LANES + k])
        store(kept, source + 4 * LANES, at_y + table[3 * LANES + k])
        found[count] = place
        count += int64(bits(w > zero) != 0)
        if bits(on) == 0:
            live &= ~(uint32(1) << uint32(k))
    return count, live
