"""The kernels' functions: vectors of lanes, in memory and across each other; the exponential, logarithm and root."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from tg4mm.fit.rasterize.kernels.tiles import TABLE, constants
from tg4mm.fit.rasterize.simd.functions import exp2
from tg4mm.fit.rasterize.simd.memory import (
    address,
    integer,
    keep,
    load,
    load_first,
    load_pixels,
    number,
    put_integer,
    put_number,
    store,
    store_first,
)
from tg4mm.fit.rasterize.simd.vector import LANES, PIXELS, ctz, popcount, select


@njit
def _exp2(x: np.ndarray, table: np.ndarray, out: np.ndarray) -> None:
    _, _, powers, _, _ = constants(table)
    for i in range(0, len(x), PIXELS):
        store(out, i, exp2(load_pixels(x, i), powers))


@njit
def _through_addresses(x: np.ndarray, words: np.ndarray) -> None:
    at, of_words = address(x), address(words)
    put_number(at, 5, number(x, 2 * 3 + 1) + number(at, 0))
    put_integer(of_words, 1, integer(of_words, 0) + popcount(integer(of_words, 0)))
    keep(x)
    keep(words)


@njit
def _lowest_bits(x: np.uint32, y: np.uint64) -> tuple[int, int]:
    return ctz(x), ctz(y)


@njit
def _of_vectors(x: np.ndarray, logarithms: np.ndarray, roots: np.ndarray) -> None:
    for i in range(0, len(x), LANES):
        value = load(x, i)
        store(logarithms, i, math.log(value))
        store(roots, i, math.sqrt(value))


@njit
def _compared(x: np.ndarray, out: np.ndarray) -> None:
    a, b, half = load(x, 0), load(x, LANES), np.float32(0.5)
    store(out, 0, min(a, b))
    store(out, LANES, max(a, half))
    store(out, 2 * LANES, abs(a))
    store(out, 3 * LANES, -a)
    store(out, 4 * LANES, math.ceil(a))
    store(out, 5 * LANES, math.floor(a))
    store(out, 6 * LANES, select(a <= b, a, np.float32(9)))
    store(out, 7 * LANES, select(a == b, a, np.float32(9)))


@njit
def _first(x: np.ndarray, count: int, out: np.ndarray) -> None:
    store(out, 0, load_first(x, 2, count))
    store_first(out, LANES, count, load(x, 0))


def test_exp2_is_as_accurate_as_it_says() -> None:
    x = -np.linspace(0, 126, 400_000, dtype=np.float32)
    out = np.empty_like(x)
    _exp2(x, TABLE, out)
    assert np.abs(out.astype(np.float64) / np.exp2(x.astype(np.float64)) - 1).max() < 3e-7
    assert out[0] == 1.0


def test_vectors_compare_as_numbers_do() -> None:
    x = np.random.default_rng(4).normal(size=(2, LANES)).astype(np.float32)
    x[1, ::5] = x[0, ::5]
    a, b = x
    out = np.empty((8, LANES), np.float32)
    _compared(x.ravel(), out.ravel())
    expected = [
        np.minimum(a, b), np.maximum(a, 0.5), np.abs(a), -a, np.ceil(a), np.floor(a),
        np.where(a <= b, a, 9), np.where(a == b, a, 9),
    ]  # fmt: skip
    np.testing.assert_array_equal(out, np.array(expected, np.float32))
    assert 0 < (a <= b).sum() < LANES
    assert 0 < (a < 0).sum() < LANES


def test_logarithm_and_root_of_vectors() -> None:
    x = np.concatenate([np.geomspace(1e-20, 300, 160_000), np.linspace(0.9, 1.1, 160_000)]).astype(np.float32)
    logarithms, roots = np.empty_like(x), np.empty_like(x)
    _of_vectors(x, logarithms, roots)
    exact = np.log(x.astype(np.float64))
    assert (np.abs(logarithms - exact) <= 2e-7 * np.abs(exact)).all()
    np.testing.assert_array_equal(roots, np.sqrt(x))


@pytest.mark.parametrize("count", [-5, 0, 3, 11, 16])
def test_the_first_lanes_alone_are_read_and_written(count: int) -> None:
    x, out = np.arange(40, dtype=np.float32), np.full(3 * LANES, -1.0, np.float32)
    _first(x, count, out)
    n = max(count, 0)
    np.testing.assert_array_equal(out[:LANES], np.where(np.arange(LANES) < n, x[2 : 2 + LANES], 0))
    np.testing.assert_array_equal(out[LANES:], np.concatenate([x[:n], np.full(2 * LANES - n, -1)]))


def test_what_is_not_contiguous_has_no_address() -> None:
    with pytest.raises(TypingError):
        _through_addresses(np.zeros((4, 4), np.float32)[:, ::2], np.zeros(2, np.uint32))


@pytest.mark.parametrize("bit", [0, 1, 17, 31])
def test_the_lowest_bit_is_found_in_words_of_either_width(bit: int) -> None:
    found = _lowest_bits(np.uint32(0xC0000000 | 1 << bit), np.uint64(1 << 63 | 1 << (bit + 30)))
    assert found == (min(bit, 30), bit + 30)
