"""The kernels' functions: vectors of lanes, in memory and across each other; the exponential, logarithm and root."""

import math

import numpy as np
from numba import njit

from tg4mm.fit.rasterize.kernels.tiles import TABLE, constants
from tg4mm.fit.rasterize.simd.functions import exp2
from tg4mm.fit.rasterize.simd.memory import load, load_pixels, store
from tg4mm.fit.rasterize.simd.vector import LANES, PIXELS


@njit
def _exp2(x, table, out):
    _, _, powers, _, _ = constants(table)
    for i in range(0, len(x), PIXELS):
        store(out, i, exp2(load_pixels(x, i), powers))


@njit
def _of_vectors(x, logarithms, roots):
    for i in range(0, len(x), LANES):
        value = load(x, i)
        store(logarithms, i, math.log(value))
        store(roots, i, math.sqrt(value))


def test_exp2_is_as_accurate_as_it_says():
    x = -np.linspace(0, 126, 400_000, dtype=np.float32)
    out = np.empty_like(x)
    _exp2(x, TABLE, out)
    assert np.abs(out.astype(np.float64) / np.exp2(x.astype(np.float64)) - 1).max() < 3e-7
    assert out[0] == 1.0


def test_logarithm_and_root_of_vectors():
    x = np.concatenate([np.geomspace(1e-20, 300, 160_000), np.linspace(0.9, 1.1, 160_000)]).astype(np.float32)
    logarithms, roots = np.empty_like(x), np.empty_like(x)
    _of_vectors(x, logarithms, roots)
    exact = np.log(x.astype(np.float64))
    assert (np.abs(logarithms - exact) <= 2e-7 * np.abs(exact)).all()
    np.testing.assert_array_equal(roots, np.sqrt(x))
