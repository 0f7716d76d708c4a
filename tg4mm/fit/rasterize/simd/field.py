"""Four rows of three float32 as one vector: a displacement and its gradient along x, y, z, four lanes a row.

The fourth lane of a row holds anything.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tg4mm.fit.rasterize.simd.memory import data_at
from tg4mm.fit.rasterize.simd.vector import F32, FV, I64, LANES, constant_lanes, of_lanes, vector

_ROWS = 4
_EACH_ROW = [lane // 4 for lane in range(LANES)]


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
