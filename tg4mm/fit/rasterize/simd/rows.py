"""Transposes: sixteen rows of a table to columns, a lane a row, and back (array of structures, structure of arrays)."""

from llvmlite import ir
from numba import types
from numba.core import cgutils

from tg4mm.fit.rasterize.simd.memory import data_at
from tg4mm.fit.rasterize.simd.vector import (
    F32,
    FV,
    I32,
    I64,
    IV,
    LANES,
    PIXELS,
    as_lanes,
    constant_lanes,
    declare,
    in_a_row,
    instruction,
    pixels,
    vector,
)


def _within_fours(builder, a, b, c, d):
    """Lane 4 r + j of the k-th to lane 4 r + k of the j-th: every group of four lanes transposed."""
    n = a.type.count
    low, high = ([g + s for g in range(0, n, 4) for s in p] for p in ((0, n, 1, n + 1), (2, n + 2, 3, n + 3)))
    pairs = [
        builder.shuffle_vector(x, y, constant_lanes(lanes))
        for lanes in (low, high)
        for x, y in ((a, b), (c, d))
    ]
    low, high = ([g + s for g in range(0, n, 4) for s in p] for p in ((0, 1, n, n + 1), (2, 3, n + 2, n + 3)))
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


@instruction(lambda a, b, c, d: types.UniTuple(vector, 4)(*[vector] * 4))
def interleave(context, builder, sig, args):
    """The inverse of `transpose`: four columns, a lane a row, to rows with their columns side by side."""
    return _of_fours(builder, *_within_fours(builder, *args))


@instruction(lambda a, b, c, d: types.UniTuple(vector, 4)(*[vector] * 4))
def transpose(context, builder, sig, args):
    """Sixteen rows of four numbers, one behind the other in four vectors, to their four columns."""
    return _within_fours(builder, *_of_fours(builder, *args))


def _fours_of(builder, a, b, group):
    """A group of four lanes of one vector, and the same of another."""
    lanes = range(4 * group, 4 * group + 4)
    return builder.shuffle_vector(a, b, constant_lanes([*lanes, *(a.type.count + k for k in lanes)]))


def _rows_of_block(context, builder, sig, args):
    """Addresses of four pixels of four channels in each row of a block: from an index on, a stride apart."""
    data, place = data_at(context, builder, sig.args[0], args[0]), args[1]
    for _ in range(PIXELS // 4):
        yield builder.bitcast(builder.gep(data, [place]), FV.as_pointer())
        place = builder.add(place, args[2])


@instruction(lambda picture, index, stride: types.UniTuple(pixels, 4)(picture, types.int64, types.int64))
def load_planes(context, builder, sig, args):
    """The four channels of a block of a picture [n], whose rows are `stride` apart: a lane a pixel."""
    rows = [builder.load(at, align=4) for at in _rows_of_block(context, builder, sig, args)]
    columns = (
        _of_fours(builder, *rows)
        if len(rows) == 4
        else [_fours_of(builder, rows[0], rows[1], k) for k in range(4)]
    )
    return _within_fours(builder, *columns)


@instruction(lambda picture, index, stride, planes: types.none(picture, types.int64, types.int64, planes))
def store_planes(context, builder, sig, args):
    """The inverse of `load_planes`."""
    columns = _within_fours(builder, *cgutils.unpack_tuple(builder, args[3]))
    if PIXELS == LANES:
        rows = _of_fours(builder, *columns)
    else:
        whole = constant_lanes(range(LANES))
        rows = [
            builder.shuffle_vector(
                *(_fours_of(builder, columns[k], columns[k + 1], r) for k in (0, 2)), whole
            )
            for r in range(2)
        ]
    for row, at in zip(rows, _rows_of_block(context, builder, sig, args), strict=True):
        builder.store(row, at, align=4)


@instruction(lambda rows, index, count: vector(types.int64, types.int64, types.int64))
def row_starts(context, builder, sig, args):
    """Sixteen times 32 bits: 16 times each of the int32 from `index` of an address on; 0 from the count-th on.

    What lies beyond is not read.
    """
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


@instruction(lambda splats, rows, column: types.UniTuple(vector, 4)(types.int64, types.int64, types.int64))
def columns(context, builder, sig, args):
    """Four columns, from `column` on, of sixteen rows: a lane a row.

    splats: address of float32; rows: that of sixteen int32, where each row begins.
    """
    splats, rows, column = args
    kind = ir.VectorType(F32, 4)
    data, starts = builder.inttoptr(splats, F32.as_pointer()), builder.inttoptr(rows, I32.as_pointer())

    def four(k):
        start = builder.zext(builder.load(builder.gep(starts, [ir.Constant(I64, k)])), I64)
        place = builder.gep(data, [builder.add(start, column)])
        return builder.load(builder.bitcast(place, kind.as_pointer()), align=4)

    # group g of the j-th vector is row 4 g + j
    fours = [in_a_row(builder, [four(4 * g + j) for g in range(4)]) for j in range(4)]
    return _within_fours(builder, *fours)


def _chosen(builder, vectors, wanted):
    """The numbers `wanted` of three vectors in a row."""
    low = [k if k < 2 * LANES else 0 for k in wanted]
    high = [lane if k < 2 * LANES else k - LANES for lane, k in enumerate(wanted)]
    both = builder.shuffle_vector(*vectors[:2], constant_lanes(low))
    return builder.shuffle_vector(both, vectors[2], constant_lanes(high))


@instruction(lambda a, b, c: types.UniTuple(vector, 3)(*[vector] * 3))
def transpose_threes(context, builder, sig, args):
    """Sixteen rows of three numbers, one behind the other in three vectors, to their three columns."""
    return [_chosen(builder, args, [first + 3 * k for k in range(LANES)]) for first in range(3)]


@instruction(lambda a, b, c: types.UniTuple(vector, 3)(*[vector] * 3))
def interleave_threes(context, builder, sig, args):
    """The inverse of `transpose_threes`."""
    places = [k % 3 * LANES + k // 3 for k in range(3 * LANES)]
    return [_chosen(builder, args, places[k : k + LANES]) for k in range(0, 3 * LANES, LANES)]


@instruction(lambda a: types.UniTuple(vector, 3)(vector))
def thrice(context, builder, sig, args):
    """Every number of a vector three times, in three vectors in a row."""
    return [
        builder.shuffle_vector(args[0], args[0], constant_lanes([(first + k) // 3 for k in range(LANES)]))
        for first in range(0, 3 * LANES, LANES)
    ]


@instruction(lambda a, b, c: types.UniTuple(vector, 3)(*[types.float32] * 3))
def cycled(context, builder, sig, args):
    """Three float32 in turn, sixteen times, in three vectors in a row."""
    each = [as_lanes(builder, x) for x in args]
    return [
        _chosen(builder, each, [(first + k) % 3 * LANES + k for k in range(LANES)])
        for first in range(0, 3 * LANES, LANES)
    ]


@instruction(lambda place, index, columns: types.none(place, types.int64, columns))
def store_rows(context, builder, sig, args):
    """Sixteen columns, a lane a row, as sixteen rows of sixteen numbers, one behind the other from an index on."""
    data = data_at(context, builder, sig.args[0], args[0])
    given = cgutils.unpack_tuple(builder, args[2])
    # group r of the j-th of the g-th four: columns 4 g … 4 g + 3 of row 4 r + j
    fours = [_within_fours(builder, *given[g : g + 4]) for g in range(0, LANES, 4)]
    for j in range(4):
        for r, row in enumerate(_of_fours(builder, *[four[j] for four in fours])):
            place = builder.add(args[1], ir.Constant(I64, (4 * r + j) * LANES))
            at = builder.bitcast(builder.gep(data, [place]), FV.as_pointer())
            builder.store(row, at, align=4)


@instruction(lambda place, index: types.UniTuple(vector, LANES)(place, types.int64))
def load_columns(context, builder, sig, args):
    """The inverse of `store_rows`. LLVM removes columns that are not used."""
    data, kind = data_at(context, builder, sig.args[0], args[0]), ir.VectorType(F32, 4)

    def four(row, column):
        at = builder.add(args[1], ir.Constant(I64, row * LANES + column))
        return builder.load(builder.bitcast(builder.gep(data, [at]), kind.as_pointer()), align=4)

    found = []
    for column in range(0, LANES, 4):
        fours = [in_a_row(builder, [four(4 * g + j, column) for g in range(4)]) for j in range(4)]
        found += _within_fours(builder, *fours)
    return found
