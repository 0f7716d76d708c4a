"""Block culling: the blocks of a tile that each Gaussian may reach, and its numbers for blending in these blocks.

Blending needs a few numbers of a Gaussian and the blocks that its ellipse may reach. With a lane for each block, each
number would have to be broadcast first. Here sixteen records are transposed instead, a lane for each Gaussian, and a
block's result is a mask of Gaussians, as a loop over blocks needs it.

A batch is a table in memory: planes as long as the batch, a number a Gaussian; then a vector a Gaussian; then, for
every sixteen Gaussians, masks of 16 bits, one a block. `weights` computes blending weights and their derivatives by the
exponent, for `linearised.py`.
"""

import numpy as np
from numba import float32, int64, uint32

from tg4mm.fit.rasterize.kernels.compiled import inlined
from tg4mm.fit.rasterize.kernels.layout import EX, MX, MY, SQUARES
from tg4mm.fit.rasterize.kernels.tiles import (
    BLOCKS,
    BY_FOUR,
    CENTRE_X,
    CENTRE_Y,
    COLUMNS,
    HEIGHT,
    PREFETCH,
    WIDTH,
    aligned,
    alphas,
)
from tg4mm.fit.rasterize.simd.lanes import store_eight
from tg4mm.fit.rasterize.simd.memory import (
    address,
    integer,
    load,
    load_pixels,
    number,
    prefetch,
    put_integer,
    store,
)
from tg4mm.fit.rasterize.simd.rows import columns, row_starts
from tg4mm.fit.rasterize.simd.vector import (
    LANES,
    PIXELS,
    broadcast,
    ctz,
    first_lanes,
    fma,
    movemask,
    put_four_masks,
    select,
    shifted,
    sign_mask,
    two_halves,
)

_ROWS = BLOCKS // COLUMNS  # of blocks in a tile
_TOP, _ROW, _L11, _L12, _L22 = range(BLOCKS + _ROWS, BLOCKS + _ROWS + 5)
_PLANES = (
    BLOCKS + _ROWS + 5
)  # how many: p at the centres of the blocks, q at those of their rows, then the above
_HALF_WIDTH, _HALF_HEIGHT = (WIDTH - 1) / 2, (HEIGHT - 1) / 2  # of a block, to its outermost pixels' centres
_OWN = 2 * PIXELS  # the vectors: by how much p and q differ from those within a block
KEPT = 5 * PIXELS  # numbers kept for each block: w, Tα, α/(1 - α), dx, dy
BATCH = 32  # pairs of a batch


def room(size):
    """float32 that a batch of `size` Gaussians needs, a multiple of 16."""
    masks = size // LANES * BLOCKS // 2
    return (_PLANES + _OWN) * size + -(-masks // LANES) * LANES


@inlined
def _mask_of(size, n, k):
    """Return the position of block k's mask for the Gaussians n … n + 15, in 16-bit units of a batch."""
    return 2 * (_PLANES + _OWN) * size + n // LANES * BLOCKS + k


@inlined
def _column(batch, at, dx, l11, l12_dy):
    """p at the centre of a block, kept at `at`."""
    p = fma(dx, l11, l12_dy)
    store(batch, at, p)
    return p


@inlined
def _reaches(p, q, half_width_p, limit):
    """Mask of the Gaussians whose ellipse may reach a block.

    A block's p and q lie within a box around those of its centre; if the box's nearest point to the origin is outside
    the ellipse, so is the block. half_width_p: of the box, in p; q: the square of how far the box lies off in q. limit:
    the ellipse's radius, squared; negative where it does not extend that far to the left or right.
    """
    out = abs(p)
    out = out - min(out, half_width_p)
    return limit >= fma(out, out, q)


@inlined
def _sixteen(splats, rows, n, size, origin, faintest, count, batch, tested):
    """The planes of the Gaussians n … n + 15 of a batch, and, if `tested`, which of them may reach each block."""
    half, half_height = float32(_HALF_WIDTH), float32(_HALF_HEIGHT)
    mx, my, ca, cb = columns(splats, rows, int64(MX))
    ex, power, r11, l22 = columns(splats, rows, int64(EX))
    h = r11 * float32(SQUARES)
    l11, l12, limit = h * ca, h * cb, power * float32(2.0 * SQUARES)
    store(batch, _TOP * size + n, limit + faintest)
    limit = first_lanes(limit, count, float32(-1.0))  # what is not there reaches nothing
    store(batch, _L11 * size + n, l11)
    store(batch, _L12 * size + n, l12)
    store(batch, _L22 * size + n, l22)
    dx0, dx1 = float32(origin[0]) + float32(2.0) - mx, float32(origin[0]) + float32(6.0) - mx
    dx2, dx3 = float32(origin[0]) + float32(10.0) - mx, float32(origin[0]) + float32(14.0) - mx
    side = ex + half
    none = float32(-1.0)
    limit0, limit1 = select(side >= abs(dx0), limit, none), select(side >= abs(dx1), limit, none)
    limit2, limit3 = select(side >= abs(dx2), limit, none), select(side >= abs(dx3), limit, none)
    half_width_p, half_width_q = fma(l11, half, abs(l12) * half_height), l22 * half_height  # l11 > 0
    masks = _mask_of(size, n, 0)
    for r in range(_ROWS):
        dy = float32(origin[1]) + float32((r + 0.5) * HEIGHT) - my
        l12_dy, q = dy * l12, dy * l22
        store(batch, (BLOCKS + r) * size + n, q)
        at = 4 * r * size + n
        p0, p1 = _column(batch, at, dx0, l11, l12_dy), _column(batch, at + size, dx1, l11, l12_dy)
        p2, p3 = (
            _column(batch, at + 2 * size, dx2, l11, l12_dy),
            _column(batch, at + 3 * size, dx3, l11, l12_dy),
        )
        if tested:
            out = abs(q)
            out = out - min(out, half_width_q)
            out = out * out
            put_four_masks(
                batch, masks // 4 + r, _reaches(p0, out, half_width_p, limit0), _reaches(p1, out, half_width_p, limit1),
                _reaches(p2, out, half_width_p, limit2), _reaches(p3, out, half_width_p, limit3),
            )  # fmt: skip


@inlined
def prefetch_gaussians(splats, pair_gaussian, first, count, end):
    """Prefetch the Gaussians of `count` pairs from `first` on of a list that ends at `end`.

    Best a few at a time: a core has some twelve line fill buffers and stalls when they are full.
    """
    for pair in range(min(first, end), min(first + count, end)):
        prefetch(splats, int64(integer(pair_gaussian, pair)) << 4)


@inlined
def fill_batch(splats, pair_gaussian, first, last, end, size, origin, lanes, faintest, batch, tested):
    """Fill `batch`, room for `size`, with the pairs first … last of a list that ends at `end`.

    origin: first pixel of the tile; lanes: x and y of pixels from their block's centre; faintest: log2 of the smallest
    alpha that counts. tested: also find the blocks each may reach, for `reaching`; the caller then prefetches later
    pairs (`prefetch_gaussians`) itself.
    """
    for n in range(last - first, size, LANES):
        for k in range(0, BLOCKS if tested else 0, LANES):
            store_eight(batch, _mask_of(size, n, k) // 2, broadcast(float32(0.0)))
    for n in range(0, last - first, LANES):
        if not tested:
            prefetch_gaussians(splats, pair_gaussian, first + n + PREFETCH, LANES, end)
        count = min(last - first - n, int64(LANES))
        rows = row_starts(pair_gaussian, first + n, count)
        store(batch, _ROW * size + n, rows)
        _sixteen(splats, batch + 4 * (_ROW * size + n), n, size, origin, faintest, count, batch, tested)
        place = _PLANES * size + n * _OWN
        for m in range(n, n + count):
            l11, l12 = number(batch, _L11 * size + m), number(batch, _L12 * size + m)
            store(batch, place, fma(lanes[0], l11, lanes[1] * l12))
            store(batch, place + PIXELS, lanes[1] * number(batch, _L22 * size + m))
            place += _OWN


@inlined
def reaching(batch, size, n, words):
    """Write which of the Gaussians n … n + 31 of a tested batch may reach each block: BLOCKS times 32 bits."""
    for k in range(0, BLOCKS, LANES):
        store(words, int64(k), two_halves(batch, _mask_of(size, n, k), _mask_of(size, n + LANES, k)))


@inlined
def by_gaussian(words, count, reached):
    """Transpose BLOCKS words with a bit a Gaussian (`reaching`) to `count` <= 32 words with a bit a block."""
    for k in range(0, BLOCKS, LANES):
        some = shifted(load(words, int64(k)), uint32(2 * LANES - count))
        for n in range(count):
            bits, at = uint32(sign_mask(some) << uint32(k)), count - 1 - n
            put_integer(reached, at, bits if k == 0 else bits | integer(reached, at))
            some = shifted(some, uint32(1))


@inlined
def row_of(batch, size, n):
    """Return the start of a batch's n-th Gaussian in `splats`."""
    return int64(integer(batch, _ROW * size + n))


@inlined
def log2_alpha(batch, size, n, k, lane_y):
    """log2 of the unbounded alpha of the n-th Gaussian of a batch in block k, a lane a pixel."""
    place = _PLANES * size + n * _OWN
    p = load_pixels(batch, place) + number(batch, k * size + n)
    q = load_pixels(batch, place + PIXELS) + number(batch, (BLOCKS + (k >> BY_FOUR)) * size + n)
    return fma(-q, q, fma(-p, p, number(batch, _TOP * size + n)))


_BATCH_PLANES = room(BATCH)


@inlined
def load_batch(splats, pair_gaussian, reached, first, last, end, x0, y0, faintest, held, batch):
    """Load, for the pairs first … last, what `weights` needs, and the blocks in which `blend_forward` saw them."""
    masks, at, _, _ = batch
    fill_batch(
        address(splats), address(pair_gaussian), first, last, end, BATCH, (x0, y0), held[:2], faintest, at, False
    )  # fmt: skip
    for n in range(last - first):
        masks[n] = reached[first + n]


@inlined
def batch_room(blocks=BLOCKS):
    """Memory for a batch: masks and planes of its pairs; for `weights` of so many blocks: `kept` and `found`."""
    return (
        np.empty(BATCH, np.uint32),
        aligned(_BATCH_PLANES),
        aligned(blocks * KEPT),
        np.empty(blocks, np.int64),
    )


@inlined
def weights(splats, i, n, live, x0, y0, faintest, table, held, state, stride, batch, count=0):
    """Compute weights and slopes in the blocks that Gaussian i, n-th of its batch, reaches; update transmittance.

    `kept` gets it from block `count` on, and `found` the place of each of these blocks in the state. Returns how many
    are there then, and the blocks still live.
    """
    masks, planes, kept, found = batch
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
