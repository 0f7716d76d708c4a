"""The kernels' functions: vectors of lanes, in memory and across each other; the exponential, logarithm and root."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from tg4mm.fit.rasterize.kernels.tiles import TABLE, constants
from tg4mm.fit.rasterize.simd.functions import exp2
from tg4mm.fit.rasterize.simd.lanes import lane_sums, load_fours, store_fours
from tg4mm.fit.rasterize.simd.masks import (
    first_lanes,
    put_mask,
    put_places,
    shifted,
    sign_mask,
    two_halves,
)
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
from tg4mm.fit.rasterize.simd.rows import (
    columns,
    cycled,
    interleave,
    interleave_threes,
    load_columns,
    row_starts,
    store_rows,
    thrice,
    transpose,
    transpose_threes,
)
from tg4mm.fit.rasterize.simd.vector import LANES, PIXELS, ctz, fma_where, movemask, popcount, select


@njit
def _exp2(x: np.ndarray, table: np.ndarray, out: np.ndarray) -> None:
    _, _, powers, _, _ = constants(table)
    for i in range(0, len(x), PIXELS):
        store(out, i, exp2(load_pixels(x, i), powers))


@njit
def _lane_sums(x: np.ndarray, out: np.ndarray) -> None:
    a, b, c, d, e = load(x, 0), load(x, 16), load(x, 32), load(x, 48), load(x, 64)
    f, g, h, i, j = load(x, 80), load(x, 96), load(x, 112), load(x, 128), load(x, 144)
    store(out, 1, lane_sums(a, b, c, d, e, f, g, h, i, j))


@njit
def _positive(x: np.ndarray, out: np.ndarray) -> int:
    value = load(x, 0)
    store(out, 0, select(value > np.float32(0), value, np.float32(-2)))
    return movemask(value > np.float32(0))


@njit
def _planes(x: np.ndarray, out: np.ndarray, back: np.ndarray) -> None:
    a, b, c, d = transpose(load(x, 0), load(x, 16), load(x, 32), load(x, 48))
    store(out, 0, a)
    store(out, 16, b)
    store(out, 32, c)
    store(out, 48, d)
    a, b, c, d = interleave(a, b, c, d)
    store(back, 0, a)
    store(back, 16, b)
    store(back, 32, c)
    store(back, 48, d)


@njit
def _block(x: np.ndarray, at: int, width: int, block: np.ndarray, out: np.ndarray) -> None:
    value = load_fours(x, at, width)
    store(block, 0, value)
    store_fours(out, at, width, value)


@njit
def _mark(x: np.ndarray, masks: np.ndarray, words: np.ndarray, back: np.ndarray) -> None:
    at = address(masks)
    for k in range(32):
        put_mask(at, k, load(x, k * LANES) > np.float32(0))
    gathered = two_halves(at, 0, LANES)
    store(words, LANES, gathered)
    for k in range(32):
        back[31 - k] = sign_mask(gathered)
        gathered = shifted(gathered, np.uint32(1))
    keep(masks)


@njit
def _places(bits: np.uint32, base: np.uint32, out: np.ndarray) -> None:
    put_places(address(out), 3, bits, base)
    keep(out)


@njit
def _records(
    table: np.ndarray, chosen: np.ndarray, first: int, count: int, starts: np.ndarray, out: np.ndarray
) -> None:
    store(starts, 0, row_starts(address(chosen), first, count))
    a, b, c, d = columns(address(table), address(starts), 12)
    store(out, 0, a)
    store(out, LANES, b)
    store(out, 2 * LANES, c)
    store(out, 3 * LANES, first_lanes(d, count, np.float32(-1.0)))
    keep(chosen)
    keep(table)
    keep(starts)


@njit
def _add_where(x: np.ndarray, out: np.ndarray) -> None:
    a, b, c = load(x, 0), load(x, LANES), load(x, 2 * LANES)
    store(out, 0, fma_where(a > np.float32(0), a, b, c))
    store(out, LANES, fma_where(a > np.float32(0), a, np.float32(3), c))


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
def _threes(x: np.ndarray, out: np.ndarray, back: np.ndarray) -> None:
    a, b, c = transpose_threes(load(x, 0), load(x, LANES), load(x, 2 * LANES))
    store(out, 0, a)
    store(out, LANES, b)
    store(out, 2 * LANES, c)
    a, b, c = interleave_threes(a, b, c)
    store(back, 0, a)
    store(back, LANES, b)
    store(back, 2 * LANES, c)


@njit
def _repeated(x: np.ndarray, out: np.ndarray) -> None:
    a, b, c = thrice(load(x, 0))
    store(out, 0, a)
    store(out, LANES, b)
    store(out, 2 * LANES, c)
    a, b, c = cycled(x[0], x[1], x[2])
    store(out, 3 * LANES, a)
    store(out, 4 * LANES, b)
    store(out, 5 * LANES, c)


@njit
def _turned_round(x: np.ndarray, sums: np.ndarray, back: np.ndarray) -> None:
    found = load_columns(x, 0)
    store(sums, 0, found[2] - found[13])
    store_rows(back, 3, found)


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


def test_rows_of_three_become_columns_and_come_back() -> None:
    x = np.arange(48, dtype=np.float32)
    out, back = np.empty_like(x), np.empty_like(x)
    _threes(x, out, back)
    np.testing.assert_array_equal(out.reshape(3, 16), x.reshape(16, 3).T)
    np.testing.assert_array_equal(back, x)


def test_numbers_repeated_and_in_turn() -> None:
    x, out = np.random.default_rng(5).normal(size=LANES).astype(np.float32), np.empty(96, np.float32)
    _repeated(x, out)
    np.testing.assert_array_equal(out[:48], np.repeat(x, 3))
    np.testing.assert_array_equal(out[48:], np.tile(x[:3], 16))


def test_a_square_of_numbers_is_turned_round_and_back() -> None:
    x = np.random.default_rng(6).normal(size=(LANES, LANES)).astype(np.float32)
    difference, back = np.empty(LANES, np.float32), np.full(3 + x.size + 1, 7.0, np.float32)
    _turned_round(x.ravel(), difference, back)
    np.testing.assert_array_equal(difference, x[:, 2] - x[:, 13])
    np.testing.assert_array_equal(back[3:-1].reshape(x.shape), x)
    assert (back[[0, 1, 2, -1]] == 7).all()


@pytest.mark.parametrize("count", [-5, 0, 3, 11, 16])
def test_the_first_lanes_alone_are_read_and_written(count: int) -> None:
    x, out = np.arange(40, dtype=np.float32), np.full(3 * LANES, -1.0, np.float32)
    _first(x, count, out)
    n = max(count, 0)
    np.testing.assert_array_equal(out[:LANES], np.where(np.arange(LANES) < n, x[2 : 2 + LANES], 0))
    np.testing.assert_array_equal(out[LANES:], np.concatenate([x[:n], np.full(2 * LANES - n, -1)]))


def test_lane_sums_keep_the_vectors_apart() -> None:
    x = np.random.default_rng(0).normal(size=(10, LANES)).astype(np.float32)
    out = np.full(18, 9.0, np.float32)
    _lane_sums(x.ravel(), out)
    np.testing.assert_allclose(out[1:11], x.sum(1, dtype=np.float64), atol=1e-5)
    np.testing.assert_array_equal(out[11:17], 0)
    assert out[0] == out[17] == 9.0


def test_masks_and_selection() -> None:
    x = np.random.default_rng(1).normal(size=LANES).astype(np.float32)
    out = np.empty(LANES, np.float32)
    mask = _positive(x, out)
    np.testing.assert_array_equal(out, np.where(x > 0, x, np.float32(-2.0)))
    assert [mask >> k & 1 for k in range(LANES)] == (x > 0).astype(int).tolist()


def test_rows_of_pixels_become_planes_of_channels_and_back() -> None:
    """Four rows of four pixels of four channels."""
    x = np.arange(64, dtype=np.float32)
    out, back = np.empty_like(x), np.empty_like(x)
    _planes(x, out, back)
    np.testing.assert_array_equal(out.reshape(4, 16), x.reshape(16, 4).T)
    np.testing.assert_array_equal(back, x)


def test_a_block_is_four_pieces_of_rows() -> None:
    x = np.arange(60, dtype=np.float32).reshape(6, 10)
    block, out = np.empty(16, np.float32), np.full_like(x, -1)
    _block(x.ravel(), 13, 10, block, out.ravel())
    np.testing.assert_array_equal(block.reshape(4, 4), x[1:5, 3:7])
    expected = np.full_like(x, -1)
    expected[1:5, 3:7] = x[1:5, 3:7]
    np.testing.assert_array_equal(out, expected)


def test_masks_become_words_and_come_back() -> None:
    """Two times 16 masks, whose lanes are items, are 16 words, whose bits are items, and those a mask an item."""
    x = np.random.default_rng(2).normal(size=(2, 16, LANES)).astype(np.float32)
    masks, words, back = np.zeros(32, np.uint16), np.zeros(3 * LANES, np.uint32), np.zeros(32, np.uint32)
    _mark(x.ravel(), masks, words.view(np.float32), back)
    np.testing.assert_array_equal(masks, ((x > 0) << np.arange(LANES)).sum(2).ravel())
    found = np.concatenate(x, 1) > 0  # [16 words, 32 items]
    np.testing.assert_array_equal(words[LANES : 2 * LANES], (found * (1 << np.arange(32))).sum(1))
    assert not words[:LANES].any()
    assert not words[2 * LANES :].any()
    np.testing.assert_array_equal(back, (found.T << np.arange(16)).sum(1))


@pytest.mark.parametrize("bits", [0, 1, 0x8000, 0b0100_0000_0010_1001, 0xFFFF])
def test_places_of_bits_stand_side_by_side(bits: int) -> None:
    out = np.full(24, 77, np.uint32)
    _places(np.uint32(bits), np.uint32(160), out)
    places = [160 + k for k in range(16) if bits >> k & 1]
    assert out.tolist() == [77] * 3 + places + [0] * (16 - len(places)) + [77] * 5


@pytest.mark.parametrize("count", [1, 7, 16])
def test_sixteen_records_are_turned_round(count: int) -> None:
    """Columns 12 … 15 of chosen rows; where fewer are chosen, row 0 stands in, and what lies beyond is not read."""
    rng = np.random.default_rng(3)
    table = rng.normal(size=(40, 16)).astype(np.float32)
    chosen = rng.integers(0, 40, 5 + count).astype(np.int32)
    starts, out = np.zeros(LANES, np.int32), np.zeros((4, LANES), np.float32)
    _records(table, chosen, 5, count, starts.view(np.float32), out.ravel())
    rows = np.concatenate([chosen[5:], np.zeros(LANES - count, np.int32)])
    np.testing.assert_array_equal(starts, 16 * rows)
    expected = table[rows, 12:].T.copy()
    expected[3, count:] = -1
    np.testing.assert_array_equal(out, expected)


def test_what_is_masked_is_not_added() -> None:
    a, b, c = x = np.random.default_rng(3).integers(-9, 9, (3, LANES)).astype(np.float32)
    out = np.zeros((2, LANES), np.float32)
    _add_where(x.ravel(), out.ravel())
    np.testing.assert_array_equal(out, np.where(a > 0, [a * b + c, a * 3 + c], c))
    assert 0 < (a > 0).sum() < LANES


def test_an_address_is_the_array_it_was_taken_of() -> None:
    x, words = np.arange(6, dtype=np.float32).reshape(2, 3) + 1, np.array([0xF0F, 0], np.uint32)
    x = np.concatenate([x, x])
    _through_addresses(x, words)
    assert x.ravel().tolist() == [1, 2, 3, 4, 5, 3, 1, 2, 3, 4, 5, 6]
    assert words.tolist() == [0xF0F, 0xF0F + 8]


def test_what_is_not_contiguous_has_no_address() -> None:
    with pytest.raises(TypingError):
        _through_addresses(np.zeros((4, 4), np.float32)[:, ::2], np.zeros(2, np.uint32))


@pytest.mark.parametrize("bit", [0, 1, 17, 31])
def test_the_lowest_bit_is_found_in_words_of_either_width(bit: int) -> None:
    found = _lowest_bits(np.uint32(0xC0000000 | 1 << bit), np.uint64(1 << 63 | 1 << (bit + 30)))
    assert found == (min(bit, 30), bit + 30)
