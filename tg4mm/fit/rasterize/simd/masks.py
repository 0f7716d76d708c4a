"""Masks of lanes in memory, a bit each, and bit operations on many of them at once.

Sixteen words of 32 bits are a vector of `vector.py` that is not read as float32.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tg4mm.fit.rasterize.simd.vector import (
    FV,
    I16,
    I32,
    IV,
    LANES,
    MV,
    PIXELS,
    as_lanes,
    constant_lanes,
    declare,
    vector,
)

_NUMBERED = ir.Constant(IV, [ir.Constant(I32, k) for k in range(LANES)])


@intrinsic
def put_mask(typingctx, at, index, condition):
    """Write a mask as the index-th of such masks from an address on."""

    def codegen(context, builder, sig, args):
        bits = ir.IntType(args[2].type.count)
        at = builder.gep(builder.inttoptr(args[0], bits.as_pointer()), [args[1]])
        builder.store(builder.bitcast(args[2], bits), at, align=1)
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, condition), codegen


@intrinsic
def put_four_masks(typingctx, at, index, a, b, c, d):
    """Write four masks one behind the other as the index-th four of such masks from an address on."""

    def codegen(context, builder, sig, args):
        parts, lanes = args[2:], args[2].type.count
        while len(parts) > 1:
            together = constant_lanes(range(2 * parts[0].type.count))
            parts = [builder.shuffle_vector(*parts[k : k + 2], together) for k in range(0, len(parts), 2)]
        bits = ir.IntType(4 * lanes)
        at = builder.gep(builder.inttoptr(args[0], bits.as_pointer()), [args[1]])
        builder.store(builder.bitcast(parts[0], bits), at, align=1)
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, a, b, c, d), codegen


@intrinsic
def two_halves(typingctx, at, low, high):
    """Sixteen words of 32 bits of low and high halves, sixteen each, from the low-th and high-th of an address on."""

    def codegen(context, builder, sig, args):
        kind = ir.VectorType(I16, LANES)
        data = builder.inttoptr(args[0], I16.as_pointer())
        low, high = (
            builder.zext(
                builder.load(builder.bitcast(builder.gep(data, [index]), kind.as_pointer()), align=2), IV
            )
            for index in args[1:]
        )
        shift = ir.Constant(IV, [ir.Constant(I32, 16)] * LANES)
        return builder.bitcast(builder.or_(low, builder.shl(high, shift)), FV)

    return vector(types.int64, types.int64, types.int64), codegen


@intrinsic
def not_empty(typingctx, at, index):
    """Which of 32 masks of pixels, from the index-th of an address on, are not empty: an integer, a bit a mask."""

    def codegen(context, builder, sig, args):
        bits = ir.IntType(PIXELS)
        kind = ir.VectorType(bits, 2 * LANES)
        data = builder.gep(builder.inttoptr(args[0], bits.as_pointer()), [args[1]])
        masks = builder.load(builder.bitcast(data, kind.as_pointer()), align=1)
        return builder.bitcast(builder.icmp_unsigned("!=", masks, ir.Constant(kind, None)), I32)

    return types.uint32(types.int64, types.int64), codegen


@intrinsic
def shifted(typingctx, words, by):
    """Sixteen times 32 bits, each shifted to the left."""

    def codegen(context, builder, sig, args):
        return builder.bitcast(builder.shl(builder.bitcast(args[0], IV), as_lanes(builder, args[1])), FV)

    return vector(vector, types.uint32), codegen


@intrinsic
def sign_mask(typingctx, words):
    """Mask, as an integer, of those of sixteen times 32 bits that have the highest bit set."""

    def codegen(context, builder, sig, args):
        lanes = builder.icmp_signed("<", builder.bitcast(args[0], IV), ir.Constant(IV, None))
        return builder.zext(builder.bitcast(lanes, I16), I32)

    return types.uint32(vector), codegen


@intrinsic
def put_places(typingctx, at, index, bits, base):
    """Write base + k for each bit k of `movemask` that is set, then zeros: sixteen uint32, from the index-th on."""

    def codegen(context, builder, sig, args):
        at, index, bits, base = args
        chosen = builder.bitcast(builder.trunc(bits, I16), MV)
        f = declare(builder, "llvm.experimental.vector.compress.v16i32", IV, [IV, MV, IV])
        places = builder.call(
            f, [builder.add(_NUMBERED, as_lanes(builder, base)), chosen, ir.Constant(IV, None)]
        )
        data = builder.gep(builder.inttoptr(at, I32.as_pointer()), [index])
        builder.store(places, builder.bitcast(data, IV.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, types.uint32, types.uint32), codegen


@intrinsic
def first_lanes(typingctx, value, count, other):
    """The first `count` lanes of a vector, then those of another, or a float32."""

    def codegen(context, builder, sig, args):
        value, count, other = args
        there = builder.icmp_unsigned("<", _NUMBERED, as_lanes(builder, builder.trunc(count, I32)))
        return builder.select(there, value, as_lanes(builder, other))

    return vector(vector, types.int64, types.float32), codegen
