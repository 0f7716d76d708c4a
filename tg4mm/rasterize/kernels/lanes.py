"""Vectors across their lanes: sums, transpositions, blocks of a picture.

Of the type of `vector.py`. No operation depends on the order of threads.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tg4mm.rasterize.kernels.memory import data_at
from tg4mm.rasterize.kernels.vector import (
    F32,
    FV,
    I32,
    I64,
    IV,
    LANES,
    as_lanes,
    constant_lanes,
    declare,
    vector,
)


def _picked(builder, a, b, picks):
    """The sum of shuffles of a and b, one for each of `picks`; a zero (None) stays one."""
    if a is None:
        return None
    other = ir.Constant(FV, None) if b is None else b
    return builder.fadd(*(builder.shuffle_vector(a, other, constant_lanes(pick)) for pick in picks))


def _each(pattern):
    """A pattern of four lanes (0 … 3 of the first, 4 … 7 of the second) in every group of four."""
    return [group + (k if k < 4 else LANES + k - 4) for group in range(0, LANES, 4) for k in pattern]


def _of_groups(pattern):
    """Groups of four lanes: 0 … 3 of the first, 4 … 7 of the second."""
    return [4 * group + k for group in pattern for k in range(4)]


_INTERLEAVED = _each((0, 4, 1, 5)), _each((2, 6, 3, 7))
_HALVES = _each((0, 1, 4, 5)), _each((2, 3, 6, 7))
_GROUP_HALVES = _of_groups((0, 1, 4, 5)), _of_groups((2, 3, 6, 7))
_GROUP_PAIRS = _of_groups((0, 2, 4, 6)), _of_groups((1, 3, 5, 7))


def _lane_sums(builder, parts):
    """One vector whose first lanes are the sums of the lanes of each part (at most 16), by a fixed tree; then zeros.

    The first two steps stay within groups of four lanes, where a shuffle is cheapest.
    """
    level = list(parts) + [None] * (LANES - len(parts))
    for picks in (_INTERLEAVED, _HALVES, _GROUP_HALVES, _GROUP_PAIRS):
        level = [_picked(builder, level[k], level[k + 1], picks) for k in range(0, len(level), 2)]
    return level[0]


@intrinsic
def lane_sums(typingctx, a, b, c, d, e, f, g, h, i, j):
    """The sum of the lanes of each of ten vectors, in lanes 0 … 9 of one, whose others are 0.

    Always added in the same order.
    """
    return vector(*[vector] * 10), lambda context, builder, sig, args: _lane_sums(builder, args)


@intrinsic
def lane_sums_of_eight(typingctx, a, b, c, d, e, f, g, h):
    """`lane_sums` of eight vectors, in lanes 0 … 7."""
    return vector(*[vector] * 8), lambda context, builder, sig, args: _lane_sums(builder, args)


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


@intrinsic
def store_eight(typingctx, array, index, value):
    """Lanes 0 … 7 to the contiguous float32 array [n]."""

    def codegen(context, builder, sig, args):
        return _store_parts(context, builder, sig, args, ((0, 8),))

    return types.none(array, types.int64, vector), codegen


def _fours(context, builder, sig, args):
    """Addresses of four vectors of four float32: from an index on, a stride apart."""
    data, place = data_at(context, builder, sig.args[0], args[0]), args[1]
    for _ in range(4):
        yield builder.bitcast(builder.gep(data, [place]), ir.VectorType(F32, 4).as_pointer())
        place = builder.add(place, args[2])


@intrinsic
def load_block(typingctx, array, index, stride):
    """Four times four float32 of a contiguous array [n], the groups `stride` apart."""

    def codegen(context, builder, sig, args):
        fours = [builder.load(at, align=4) for at in _fours(context, builder, sig, args)]
        eight = constant_lanes(range(8))
        low, high = (builder.shuffle_vector(*fours[k : k + 2], eight) for k in (0, 2))
        return builder.shuffle_vector(low, high, constant_lanes(range(LANES)))

    return vector(array, types.int64, types.int64), codegen


@intrinsic
def store_block(typingctx, array, index, stride, value):
    """What `load_block` reads."""

    def codegen(context, builder, sig, args):
        for k, at in enumerate(_fours(context, builder, sig, args)):
            part = builder.shuffle_vector(args[3], args[3], constant_lanes(range(4 * k, 4 * k + 4)))
            builder.store(part, at, align=4)
        return context.get_dummy_value()

    return types.none(array, types.int64, types.int64, vector), codegen


def _within_fours(builder, a, b, c, d):
    """Lane 4 r + j of the k-th to lane 4 r + k of the j-th: every group of four lanes transposed."""
    low, high = ([g + s for g in range(0, LANES, 4) for s in p] for p in ((0, 16, 1, 17), (2, 18, 3, 19)))
    pairs = [
        builder.shuffle_vector(x, y, constant_lanes(lanes))
        for lanes in (low, high)
        for x, y in ((a, b), (c, d))
    ]
    low, high = ([g + s for g in range(0, LANES, 4) for s in p] for p in ((0, 1, 16, 17), (2, 3, 18, 19)))
    return [
        builder.shuffle_vector(*pairs[k : k + 2], constant_lanes(lanes))
        for k in (0, 2)
        for lanes in (low, high)
    ]


def _of_fours(builder, a, b, c, d):
    """Group r of the k-th to group k of the r-th: four vectors of four groups of four lanes transposed."""

    def groups(x, y, picks):
        return builder.shuffle_vector(x, y, constant_lanes([4 * g + k for g in picks for k in range(4)]))

    halves = [(groups(x, y, (0, 1, 4, 5)), groups(x, y, (2, 3, 6, 7))) for x, y in ((a, b), (c, d))]
    return [groups(halves[0][h], halves[1][h], p) for h in (0, 1) for p in ((0, 2, 4, 6), (1, 3, 5, 7))]


@intrinsic
def rows_of_planes(typingctx, a, b, c, d):
    """Four channels of a block, a lane a pixel, to the block's four rows, channels of a pixel side by side."""

    def codegen(context, builder, sig, args):
        rows = _of_fours(builder, *_within_fours(builder, *args))
        return context.make_tuple(builder, sig.return_type, rows)

    return types.UniTuple(vector, 4)(*[vector] * 4), codegen


@intrinsic
def planes_of_rows(typingctx, a, b, c, d):
    """The inverse of `rows_of_planes`."""

    def codegen(context, builder, sig, args):
        planes = _within_fours(builder, *_of_fours(builder, *args))
        return context.make_tuple(builder, sig.return_type, planes)

    return types.UniTuple(vector, 4)(*[vector] * 4), codegen


@intrinsic
def row_starts(typingctx, rows, index, count):
    """Sixteen times 32 bits: 16 times each of the int32 from `index` of an address on; 0 from the count-th on.

    What lies beyond is not read.
    """

    def codegen(context, builder, sig, args):
        at, index, count = args
        data = builder.inttoptr(at, I32.as_pointer())
        place = builder.bitcast(builder.gep(data, [index]), IV.as_pointer())
        lanes = ir.Constant(IV, [ir.Constant(I32, k) for k in range(LANES)])
        there = builder.icmp_unsigned("<", lanes, as_lanes(builder, builder.trunc(count, I32)))
        kinds = [IV.as_pointer(), I32, there.type, IV]
        f = declare(builder, "llvm.masked.load.v16i32.p0", IV, kinds)
        found = builder.call(f, [place, ir.Constant(I32, 4), there, ir.Constant(IV, None)])
        shift = ir.Constant(IV, [ir.Constant(I32, 4)] * LANES)
        return builder.bitcast(builder.shl(found, shift), FV)

    return vector(types.int64, types.int64, types.int64), codegen


@intrinsic
def columns(typingctx, splats, rows, column):
    """Four columns, from `column` on, of sixteen rows: a lane a row.

    splats: address of float32; rows: that of sixteen int32, where each row begins.
    """

    def codegen(context, builder, sig, args):
        splats, rows, column = args
        kind = ir.VectorType(F32, 4)
        data, starts = builder.inttoptr(splats, F32.as_pointer()), builder.inttoptr(rows, I32.as_pointer())

        def four(k):
            start = builder.zext(builder.load(builder.gep(starts, [ir.Constant(I64, k)])), I64)
            place = builder.gep(data, [builder.add(start, column)])
            return builder.load(builder.bitcast(place, kind.as_pointer()), align=4)

        def together(parts):
            eight = constant_lanes(range(8))
            low, high = (builder.shuffle_vector(*parts[k : k + 2], eight) for k in (0, 2))
            return builder.shuffle_vector(low, high, constant_lanes(range(LANES)))

        # group g of the j-th vector is row 4 g + j
        fours = [together([four(4 * g + j) for g in range(4)]) for j in range(4)]
        return context.make_tuple(builder, sig.return_type, _within_fours(builder, *fours))

    return types.UniTuple(vector, 4)(types.int64, types.int64, types.int64), codegen
