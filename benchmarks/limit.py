"""What the arithmetic of blending alone would take: visible pixel evaluations × vector instructions / (cores × clock).

The instructions are those of the inner loops' machine code on AVX-512 that calculate (no loads, stores or moves), one
512-bit instruction a cycle and core, as Zen 4 does it. Every lane is taken to be useful, which a 4 × 4 block's are not.
"""

import math
import time

import numpy as np
from numba import float32, njit

from tg4mm.rasterize.kernels.layout import ALPHA_MAX, ALPHA_MIN, CA, CB, CC, MX, MY, OP, T_MIN, TILE

FORWARD_INSTRUCTIONS = 25
BACKWARD_INSTRUCTIONS = 51
_STEPS = 20_000_000


@njit(cache=True)
def _chain(n, x):
    """n steps of six instructions of one cycle, each waiting for the one before."""
    for _ in range(n):
        x ^= x << np.uint64(13)
        x ^= x >> np.uint64(7)
        x ^= x << np.uint64(17)
    return x


def clock_ghz() -> float:
    """The processor's clock now, by the shortest of five dependent chains, in processor time."""
    _chain(1, np.uint64(1))
    seconds = []
    for _ in range(5):
        start = time.process_time()
        _chain(_STEPS, np.uint64(1))
        seconds.append(time.process_time() - start)
    return 6 * _STEPS / min(seconds) / 1e9


@njit(cache=True)
def visible_evaluations(splats, tile_start, pair_gaussian, width, height):
    """Number of (pixel, Gaussian) with alpha >= 1/255 where the pixel still takes light."""
    n_x = (width + TILE - 1) // TILE
    total = 0
    for tile in range(len(tile_start) - 1):
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        for y in range(y0, min(y0 + TILE, height)):
            for x in range(x0, min(x0 + TILE, width)):
                t = 1.0
                for pair in range(tile_start[tile], tile_start[tile + 1]):
                    i = pair_gaussian[pair]
                    dx, dy = x + float32(0.5) - splats[i, MX], y + float32(0.5) - splats[i, MY]
                    sigma = (splats[i, CA] * dx * dx + splats[i, CC] * dy * dy) / 2 + splats[i, CB] * dx * dy
                    alpha = min(splats[i, OP] * math.exp(-sigma), ALPHA_MAX)
                    if alpha >= ALPHA_MIN:
                        total += 1
                        t *= 1 - alpha
                        if t <= T_MIN:
                            break
    return total
