"""A tile's pixels to the picture: what its Gaussians gave, and what lies where none is.

Writes to memory outside the caches are slow, and few can be in flight at a time. So pixels are prefetched
(`prefetch_pixels` of `tiles.py`), and tiles that no Gaussian reaches are written a row here and there in between.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

from numba import float32, int64, uint32

from tg4mm.fit.rasterize.kernels.compiled import inlined
from tg4mm.fit.rasterize.kernels.layout import FEATURES, TILE
from tg4mm.fit.rasterize.kernels.tiles import BLOCKS, corner, pixel
from tg4mm.fit.rasterize.simd.lanes import store_fours
from tg4mm.fit.rasterize.simd.memory import integer, load_pixels, number, store
from tg4mm.fit.rasterize.simd.rows import store_planes
from tg4mm.fit.rasterize.simd.vector import PIXELS

STRIDE = (2 + FEATURES) * PIXELS  # planes of a block: transmittance as it runs on, as it stopped, features


@inlined
def begin_blocks(state, nothing):
    """Nothing met yet. nothing: a vector of zeros and one of ones, in registers."""
    zero, one = nothing
    for k in range(BLOCKS):
        place = int64(k * STRIDE)
        store(state, place, one)
        store(state, place + PIXELS, one)
        for c in range(FEATURES):
            store(state, place + (2 + c) * PIXELS, zero)


@inlined
def write_tile(state, x0, y0, frame, image, transmittance):
    """A tile's state to the picture [H · W · FEATURES] and the transmittance [H · W]."""
    width, height = frame
    rows, columns = min(TILE, height - y0), min(TILE, width - x0)
    if rows == TILE and columns == TILE:
        step = int64(width * FEATURES)
        for k in range(BLOCKS):
            place, at = k * STRIDE, corner(k, x0, y0, width)
            store_fours(transmittance, at, int64(width), load_pixels(state, place + PIXELS))
            planes = (
                load_pixels(state, place + 2 * PIXELS), load_pixels(state, place + 3 * PIXELS),
                load_pixels(state, place + 4 * PIXELS), load_pixels(state, place + 5 * PIXELS),
            )  # fmt: skip
            store_planes(image, at * FEATURES, step, planes)
        return
    for r in range(rows):
        for j in range(columns):
            at, to = pixel(r, j, STRIDE), (y0 + r) * width + x0 + j
            transmittance[to] = number(state, PIXELS + at)
            for k in range(FEATURES):
                image[to * FEATURES + k] = number(state, (2 + k) * PIXELS + at)


@inlined
def write_blank(first, last, rows, n_x, frame, nothing, image, transmittance):
    """Write the entries first … last - 1 of a list of rows, TILE pixels each, of tiles that no Gaussian reaches.

    rows: the list's address. An entry is y · n_x + column, y the row of pixels and column that of tiles.
    """
    width = frame[0]
    zero, one = nothing
    for n in range(first, last):
        row = integer(rows, n)
        x, y = int64(row % uint32(n_x)) * TILE, int64(row // uint32(n_x))
        at = int64(y * width + x)
        if x + TILE <= width:
            for c in range(TILE // PIXELS):
                store(transmittance, at + c * PIXELS, one)
            for c in range(TILE * FEATURES // PIXELS):
                store(image, at * FEATURES + c * PIXELS, zero)
        else:
            for to in range(at, at + width - x):
                transmittance[to] = float32(1.0)
                for c in range(FEATURES):
                    image[to * FEATURES + c] = float32(0.0)
