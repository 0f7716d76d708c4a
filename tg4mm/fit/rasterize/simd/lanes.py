"""Sums across the lanes of vectors by a fixed tree, and loads and stores of parts of vectors.

A displacement and its gradient along x, y, z are four rows of three float32, one vector: four lanes a row, of which the
fourth holds anything.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tg4mm.fit.rasterize.simd.memory import data_at
from tg4mm.fit.rasterize.simd.vector import (
    F32,
    FV,
    I64,
    LANES,
    constant_lanes,
    half,
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


@intrinsic
def lane_sums(typingctx, a, b, c, d, e, f, g, h, i, j):
    """The sum of the lanes of each of ten vectors, in lanes 0 … 9 of one, whose others are 0.

    Always added in the same order.
    """
    return vector(*[a] * 10), lambda context, builder, sig, args: _lane_sums(builder, args)


@intrinsic
def lane_sums_of_eight(typingctx, a, b, c, d, e, f, g, h):
    """`lane_sums` of eight vectors, in lanes 0 … 7."""
    return vector(*[a] * 8), lambda context, builder, sig, args: _lane_sums(builder, args)


@intrinsic
def half_sums_of_eight(typingctx, a, b, c, d, e, f, g, h):
    """The sums of the lower eight lanes of each of eight vectors, in lanes 0 … 7, and of the upper ones, in 8 … 15."""
    return vector(*[vector] * 8), lambda context, builder, sig, args: _lane_sums(
        builder, args, (_OF_EACH_HALF,)
    )


def _store_parts(context, builder, sig, args, parts):
    """Store the lanes first … first + count for each of `parts`."""
    data = data_at(context, builder, sig.args[0], args[0])
    for first, count in parts:
        kind = ir.VectorType(F32, count)
        lanes = constant_lanes(range(first, first + count))
        part = builder.shuffle_vector(args[2], args[2], lanes)
        place = builder.gep(data, [builder.add(args[1], ir.Constant(I64, first))])
        builder.store(part, builder.bitcast(place, kind.as_pointer()), align=4)
    return context.get_dummy_value()


def _eight(lanes):
    """An intrinsic that loads eight numbers of a contiguous float32 array [n] and shuffles them; lane 8 is a zero."""

    def typed(typingctx, array, index):
        def codegen(context, builder, sig, args):
            place = builder.gep(data_at(context, builder, sig.args[0], args[0]), [args[1]])
            kind = ir.VectorType(F32, 8)
            eight = builder.load(builder.bitcast(place, kind.as_pointer()), align=4)
            return builder.shuffle_vector(eight, ir.Constant(kind, None), constant_lanes(lanes))

        return vector(array, types.int64), codegen

    return intrinsic(typed)


load_eight = _eight([*range(8), *[8] * 8])  # then eight zeros
load_twice = _eight([*range(8)] * 2)


@intrinsic
def store_eight(typingctx, array, index, value):
    """Lanes 0 … 7 to the contiguous float32 array [n]."""

    def codegen(context, builder, sig, args):
        return _store_parts(context, builder, sig, args, ((0, 8),))

    return types.none(array, types.int64, vector), codegen


def _fours(context, builder, sig, args, count):
    """Addresses of so many vectors of four float32: from an index on, a stride apart."""
    data, place = data_at(context, builder, sig.args[0], args[0]), args[1]
    for _ in range(count):
        yield builder.bitcast(builder.gep(data, [place]), ir.VectorType(F32, 4).as_pointer())
        place = builder.add(place, args[2])


def _loading_fours(kind):
    """Groups of four float32 of a contiguous array [n], the groups `stride` apart."""

    def typed(typingctx, array, index, stride):
        def codegen(context, builder, sig, args):
            parts = [builder.load(at, align=4) for at in _fours(context, builder, sig, args, kind.lanes // 4)]
            while len(parts) > 1:
                together = constant_lanes(range(2 * parts[0].type.count))
                parts = [
                    builder.shuffle_vector(parts[k], parts[k + 1], together) for k in range(0, len(parts), 2)
                ]
            return parts[0]

        return kind(array, types.int64, types.int64), codegen

    return intrinsic(typed)


load_fours, load_two_fours = _loading_fours(vector), _loading_fours(half)
load_block = load_fours if pixels == vector else load_two_fours  # of a picture of one channel


@intrinsic
def store_fours(typingctx, array, index, stride, value):
    """Store what `load_fours` or `load_block` reads."""

    def codegen(context, builder, sig, args):
        for k, at in enumerate(_fours(context, builder, sig, args, args[3].type.count // 4)):
            part = builder.shuffle_vector(args[3], args[3], constant_lanes(range(4 * k, 4 * k + 4)))
            builder.store(part, at, align=4)
        return context.get_dummy_value()

    return types.none(array, types.int64, types.int64, value), codegen


def _at(context, builder, sig, args, count, offset=0):
    """Pointer to `count` float32 of the place args[0], `offset` after entry args[1]."""
    place = builder.gep(data_at(context, builder, sig.args[0], args[0]), [args[1]])
    place = builder.gep(place, [ir.Constant(I64, offset)])
    return builder.bitcast(place, ir.VectorType(F32, count).as_pointer())


def _broadcast(context, builder, sig, args, offset=0):
    four = builder.load(_at(context, builder, sig, args, 4, offset), align=4)
    return builder.shuffle_vector(four, four, constant_lanes(_EACH_ROW))


@intrinsic
def broadcast_rows(typingctx, array, index):
    """Four float32 of a contiguous array [n], each over the lanes of its row."""

    def codegen(context, builder, sig, args):
        return _broadcast(context, builder, sig, args)

    return vector(array, types.int64), codegen


@intrinsic
def load_field(typingctx, array, index):
    """Four rows of three float32 of a contiguous array [n]."""

    def codegen(context, builder, sig, args):
        low = builder.load(_at(context, builder, sig, args, 8), align=4)
        high = builder.load(_at(context, builder, sig, args, 4, 8), align=4)
        high = builder.shuffle_vector(high, high, constant_lanes([0, 1, 2, 3] * 2))
        return builder.shuffle_vector(
            low, high, constant_lanes([3 * (k // 4) + min(k % 4, 2) for k in range(LANES)])
        )

    return vector(array, types.int64), codegen


@intrinsic
def store_field(typingctx, array, index, value):
    """The inverse of `load_field`."""

    def codegen(context, builder, sig, args):
        lanes = [k for k in range(LANES) if k % 4 < 3]
        for offset, some in ((0, lanes[:8]), (8, lanes[8:])):
            part = builder.shuffle_vector(args[2], args[2], constant_lanes(some))
            builder.store(part, _at(context, builder, sig, args, len(some), offset), align=4)
        return context.get_dummy_value()

    return types.none(array, types.int64, vector), codegen


@intrinsic
def sum_rows(typingctx, value):
    """The sum of the four rows, in each row."""

    def codegen(context, builder, sig, args):
        total = args[0]
        for shift in (8, 4):
            lanes = constant_lanes([(k + shift) % LANES for k in range(LANES)])
            total = builder.fadd(total, builder.shuffle_vector(total, total, lanes))
        return total

    return vector(vector), codegen


@intrinsic
def transposed_times(typingctx, array, index, value):
    """Mᵀ times four rows, of the 4 × 4 block M that begins at `index` of a contiguous float32 array [n]."""

    def codegen(context, builder, sig, args):
        total = ir.Constant(FV, None)
        for row in range(_ROWS):
            column = _broadcast(context, builder, sig, args, _ROWS * row)
            lanes = constant_lanes([_ROWS * row + k % 4 for k in range(LANES)])
            there = builder.shuffle_vector(args[2], args[2], lanes)
            total = of_lanes(builder, "fmuladd", column, there, total)
        return total

    return vector(array, types.int64, vector), codegen
