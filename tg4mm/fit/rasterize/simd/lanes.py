"""Sums across the lanes of vectors by a fixed tree, and loads and stores of parts of vectors.

A displacement and its gradient along x, y, z are four rows of three float32, one vector: four lanes a row, of which the
fourth holds anything.
"""

from llvmlite import ir
from numba import types

from tg4mm.fit.rasterize.simd.memory import data_at
from tg4mm.fit.rasterize.simd.vector import (
    F32,
    FV,
    I64,
    LANES,
    constant_lanes,
    half,
    in_a_row,
    instruction,
    of_lanes,
    pixels,
    vector,
)

_ROWS = 4
_EACH_ROW = [lane // 4 for lane in range(LANES)]
_INTERLEAVED, _HALVES = ((0, 4, 1, 5), (2, 6, 3, 7)), ((0, 1, 4, 5), (2, 3, 6, 7))


def _picked(builder, a, b, picks):
    """The sum of shuffles of a and b, one for each of `picks`; a zero (None) stays one."""
    if a is None:
        return None
    other = ir.Constant(a.type, None) if b is None else b
    return builder.fadd(*(builder.shuffle_vector(a, other, constant_lanes(pick)) for pick in picks))


def _each(pattern, lanes=LANES):
    """A pattern of four lanes (0 … 3 of the first, 4 … 7 of the second) in every group of four."""
    return [group + (k if k < 4 else lanes + k - 4) for group in range(0, lanes, 4) for k in pattern]


def _of_groups(pattern):
    """Groups of four lanes, counted through the first and the second."""
    return [4 * group + k for group in pattern for k in range(4)]


_GROUP_HALVES = _of_groups((0, 1, 4, 5)), _of_groups((2, 3, 6, 7))
_GROUP_PAIRS = _of_groups((0, 2, 4, 6)), _of_groups((1, 3, 5, 7))
_OF_EACH_HALF = _of_groups((0, 4, 2, 6)), _of_groups((1, 5, 3, 7))
_OF_HALVES = _of_groups((0, 2)), _of_groups((1, 3))


def _added(builder, parts, steps):
    """Vectors added in pairs, step by step."""
    level = list(parts)
    for picks in steps:
        level = [_picked(builder, level[k], level[k + 1], picks) for k in range(0, len(level), 2)]
    return level


def _lane_sums(builder, parts, last=(_GROUP_HALVES, _GROUP_PAIRS)):
    """One vector whose first lanes are the sums of the lanes of each part (at most 16), by a fixed tree; then zeros.

    The first two steps stay within groups of four lanes, where a shuffle is cheapest; `last` adds the groups. Of parts
    of eight lanes there are two groups, hence one such step and two results.
    """
    lanes = parts[0].type.count
    within = [tuple(_each(pick, lanes) for pick in picks) for picks in (_INTERLEAVED, _HALVES)]
    if lanes == LANES:
        return _added(builder, list(parts) + [None] * ((4 << len(last)) - len(parts)), (*within, *last))[0]
    low, high = _added(builder, list(parts) + [None] * (LANES - len(parts)), (*within, _OF_HALVES))
    high = ir.Constant(low.type, None) if high is None else high
    return builder.shuffle_vector(low, high, constant_lanes(range(LANES)))


@instruction(lambda a, b, c, d, e, f, g, h, i, j: vector(*[a] * 10))
def lane_sums(context, builder, sig, args):
    """The sum of the lanes of each of ten vectors, in lanes 0 … 9 of one, whose others are 0.

    Always added in the same order.
    """
    return _lane_sums(builder, args)


@instruction(lambda a, b, c, d, e, f, g, h: vector(*[a] * 8))
def lane_sums_of_eight(context, builder, sig, args):
    """`lane_sums` of eight vectors, in lanes 0 … 7."""
    return _lane_sums(builder, args)


@instruction(lambda a, b, c, d, e, f, g, h: vector(*[vector] * 8))
def half_sums_of_eight(context, builder, sig, args):
    """The sums of the lower eight lanes of each of eight vectors, in lanes 0 … 7, and of the upper ones, in 8 … 15."""
    return _lane_sums(builder, args, (_OF_EACH_HALF,))


def _at(context, builder, sig, args, count, offset=0):
    """Pointer to `count` float32 of the place args[0], `offset` after entry args[1]."""
    place = builder.gep(data_at(context, builder, sig.args[0], args[0]), [args[1]])
    place = builder.gep(place, [ir.Constant(I64, offset)])
    return builder.bitcast(place, ir.VectorType(F32, count).as_pointer())


def _eight(lanes):
    """An intrinsic that loads eight numbers of a contiguous float32 array [n] and shuffles them; lane 8 is a zero."""

    @instruction(lambda array, index: vector(array, types.int64))
    def eight(context, builder, sig, args):
        read = builder.load(_at(context, builder, sig, args, 8), align=4)
        return builder.shuffle_vector(read, ir.Constant(read.type, None), constant_lanes(lanes))

    return eight


load_eight = _eight([*range(8), *[8] * 8])  # then eight zeros
load_twice = _eight([*range(8)] * 2)


@instruction(lambda array, index, value: types.none(array, types.int64, vector))
def store_eight(context, builder, sig, args):
    """Lanes 0 … 7 to the contiguous float32 array [n]."""
    part = builder.shuffle_vector(args[2], args[2], constant_lanes(range(8)))
    builder.store(part, _at(context, builder, sig, args, 8), align=4)


def _fours(context, builder, sig, args, count):
    """Addresses of so many vectors of four float32: from an index on, a stride apart."""
    data, place = data_at(context, builder, sig.args[0], args[0]), args[1]
    for _ in range(count):
        yield builder.bitcast(builder.gep(data, [place]), ir.VectorType(F32, 4).as_pointer())
        place = builder.add(place, args[2])


def _loading_fours(kind):
    """Groups of four float32 of a contiguous array [n], the groups `stride` apart."""

    @instruction(lambda array, index, stride: kind(array, types.int64, types.int64))
    def loading(context, builder, sig, args):
        fours = _fours(context, builder, sig, args, kind.lanes // 4)
        return in_a_row(builder, [builder.load(at, align=4) for at in fours])

    return loading


load_fours, load_two_fours = _loading_fours(vector), _loading_fours(half)
load_block = load_fours if pixels == vector else load_two_fours  # of a picture of one channel


@instruction(lambda array, index, stride, value: types.none(array, types.int64, types.int64, value))
def store_fours(context, builder, sig, args):
    """Store what `load_fours` or `load_block` reads."""
    for k, at in enumerate(_fours(context, builder, sig, args, args[3].type.count // 4)):
        part = builder.shuffle_vector(args[3], args[3], constant_lanes(range(4 * k, 4 * k + 4)))
        builder.store(part, at, align=4)


def _broadcast(context, builder, sig, args, offset=0):
    four = builder.load(_at(context, builder, sig, args, 4, offset), align=4)
    return builder.shuffle_vector(four, four, constant_lanes(_EACH_ROW))


@instruction(lambda array, index: vector(array, types.int64))
def broadcast_rows(context, builder, sig, args):
    """Four float32 of a contiguous array [n], each over the lanes of its row."""
    return _broadcast(context, builder, sig, args)


@instruction(lambda array, index: vector(array, types.int64))
def load_field(context, builder, sig, args):
    """Four rows of three float32 of a contiguous array [n]."""
    low = builder.load(_at(context, builder, sig, args, 8), align=4)
    high = builder.load(_at(context, builder, sig, args, 4, 8), align=4)
    high = builder.shuffle_vector(high, high, constant_lanes([0, 1, 2, 3] * 2))
    return builder.shuffle_vector(
        low, high, constant_lanes([3 * (k // 4) + min(k % 4, 2) for k in range(LANES)])
    )


@instruction(lambda array, index, value: types.none(array, types.int64, vector))
def store_field(context, builder, sig, args):
    """The inverse of `load_field`."""
    lanes = [k for k in range(LANES) if k % 4 < 3]
    for offset, some in ((0, lanes[:8]), (8, lanes[8:])):
        part = builder.shuffle_vector(args[2], args[2], constant_lanes(some))
        builder.store(part, _at(context, builder, sig, args, len(some), offset), align=4)


@instruction(lambda value: vector(vector))
def sum_rows(context, builder, sig, args):
    """The sum of the four rows, in each row."""
    total = args[0]
    for shift in (8, 4):
        lanes = constant_lanes([(k + shift) % LANES for k in range(LANES)])
        total = builder.fadd(total, builder.shuffle_vector(total, total, lanes))
    return total


@instruction(lambda array, index, value: vector(array, types.int64, vector))
def transposed_times(context, builder, sig, args):
    """Mᵀ times four rows, of the 4 × 4 block M that begins at `index` of a contiguous float32 array [n]."""
    total = ir.Constant(FV, None)
    for row in range(_ROWS):
        column = _broadcast(context, builder, sig, args, _ROWS * row)
        lanes = constant_lanes([_ROWS * row + k % 4 for k in range(LANES)])
        there = builder.shuffle_vector(args[2], args[2], lanes)
        total = of_lanes(builder, "fmuladd", column, there, total)
    return total
