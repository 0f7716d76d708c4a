"""Sixteen float32, and eight, as numba types, their operators and masks.

The types are LLVM's <16 x float> (`vector`: one register with AVX-512, two with AVX2, four with SSE or NEON) and
<8 x float> (`half`). `a * b + c` is not fused; `fma` is, where the processor can.

`pixels` is the one of the two that blending works on, a lane a pixel: `vector` with AVX-512, `half` elsewhere, where
there are but sixteen registers, narrower ones, and the state of sixteen pixels does not fit into them.

Masks of lanes lie in memory as a bit each; sixteen words of 32 bits are a vector that is not read as float32.
"""

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 16
F32, I32, I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
I16 = ir.IntType(LANES)
FV, IV, MV = (ir.VectorType(t, LANES) for t in (F32, I32, ir.IntType(1)))
_NUMBERED = ir.Constant(IV, [ir.Constant(I32, k) for k in range(LANES)])


def has_avx512(context):
    """Whether the target has AVX-512 (DQ): 32-entry look-ups, masked arithmetic, `vreduceps`."""
    return "+avx512dq" in context.codegen().magic_tuple()[2]


PIXELS = LANES if has_avx512(cpu_target.target_context) else LANES // 2


class Vector(types.Type):
    """So many float32."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Float32x{lanes}")


class Mask(types.Type):
    """So many truth values."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Mask{lanes}")


vector, half = Vector(LANES), Vector(LANES // 2)
mask_of = {kind: Mask(kind.lanes) for kind in (vector, half)}
mask, pixels = mask_of[vector], vector if PIXELS == LANES else half


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, ir.VectorType(F32, kind.lanes))


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, ir.VectorType(ir.IntType(1), kind.lanes))


def constant_lanes(lanes):
    """The mask operand of a shuffle."""
    picked = [ir.Constant(I32, k) for k in lanes]
    return ir.Constant(ir.VectorType(I32, len(picked)), picked)


def as_lanes(builder, scalar, lanes=LANES):
    """A float32 or an integer of 32 bits in every lane."""
    kind = ir.VectorType(scalar.type, lanes)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), scalar, ir.Constant(I32, 0))
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), constant_lanes([0] * lanes))


def _as_vector(builder, value, lanes):
    return value if isinstance(value.type, ir.VectorType) else as_lanes(builder, value, lanes)


def _widest(*kinds):
    """Return the vector type among the types of arguments; None where there are two, or none."""
    found = {kind for kind in kinds if isinstance(kind, Vector)}
    return found.pop() if len(found) == 1 else None


def _register(op, compares, emit):
    @infer_global(op)
    class _Operator(ConcreteTemplate):
        cases = [  # noqa: RUF012
            signature(mask_of[kind] if compares else kind, a, b)
            for kind in mask_of
            for a, b in ((kind, kind), (kind, types.float32), (types.float32, kind))
        ]

    for case in _Operator.cases:

        @lower_builtin(op, *case.args)
        def lower(context, builder, sig, args):
            lanes = sig.return_type.lanes
            return emit(builder, *(_as_vector(builder, x, lanes) for x in args))


_register(operator.add, False, lambda b, x, y: b.fadd(x, y))
_register(operator.sub, False, lambda b, x, y: b.fsub(x, y))
_register(operator.mul, False, lambda b, x, y: b.fmul(x, y))
# a reciprocal with one step of Newton's method where the processor has one: 1 to 2 units in the last place
_register(
    operator.truediv, False, lambda b, x, y: b.fdiv(x, y, flags=("arcp", "afn", "ninf", "nnan", "contract"))
)
_register(min, False, lambda b, x, y: b.select(b.fcmp_ordered("<", x, y), x, y))
_register(max, False, lambda b, x, y: b.select(b.fcmp_ordered(">", x, y), x, y))
_register(operator.gt, True, lambda b, x, y: b.fcmp_ordered(">", x, y))
_register(operator.ge, True, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_register(operator.lt, True, lambda b, x, y: b.fcmp_ordered("<", x, y))
_register(operator.le, True, lambda b, x, y: b.fcmp_ordered("<=", x, y))
_register(operator.eq, True, lambda b, x, y: b.fcmp_ordered("==", x, y))


def _register_one(op, emit):
    @infer_global(op)
    class _Operator(ConcreteTemplate):
        cases = [signature(kind, kind) for kind in mask_of]  # noqa: RUF012

    for kind in mask_of:

        @lower_builtin(op, kind)
        def lower(context, builder, sig, args):
            return emit(builder, args[0])


_register_one(operator.neg, lambda b, x: b.fneg(x))
_register_one(abs, lambda b, x: of_lanes(b, "fabs", x))


@infer_global(operator.and_)
class _And(ConcreteTemplate):
    cases = [signature(kind, kind, kind) for kind in mask_of.values()]  # noqa: RUF012


def _and(context, builder, sig, args):
    return builder.and_(*args)


for _kind in mask_of.values():
    lower_builtin(operator.and_, _kind, _kind)(_and)


def declare(builder, name, result, arguments):
    return cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, arguments), name)


def of_lanes(builder, name, *args):
    """LLVM's function `name` of vectors of one type: fmuladd, fabs, sqrt and others."""
    kind = args[0].type
    return builder.call(declare(builder, f"llvm.{name}.v{kind.count}f32", kind, [kind] * len(args)), args)


def _broadcasting(kind):
    def typed(typingctx, x):
        return kind(types.float32), lambda context, builder, sig, args: as_lanes(builder, args[0], kind.lanes)

    return intrinsic(typed)


broadcast = _broadcasting(vector)  # a float32 in all lanes
broadcast_half = _broadcasting(half)
broadcast_pixels = broadcast if pixels == vector else broadcast_half


@intrinsic
def fma(typingctx, a, b, c):
    """a · b + c, rounded once where the processor can. Each a vector or a float32."""

    def codegen(context, builder, sig, args):
        lanes = sig.return_type.lanes
        return of_lanes(builder, "fmuladd", *(_as_vector(builder, x, lanes) for x in args))

    kind = _widest(a, b, c)
    return (kind(a, b, c), codegen) if kind else None


@intrinsic
def fma_where(typingctx, condition, a, b, c):
    """a · b + c where the mask is set, else c; a a vector, b finite.

    AVX-512 masks the instruction itself. Elsewhere a is set to 0, once for all calls with the same mask and a.
    """

    def codegen(context, builder, sig, args):
        lanes = sig.return_type.lanes
        condition, a, b, c = args[0], *(_as_vector(builder, x, lanes) for x in args[1:])
        masked = has_avx512(context)
        if not masked:
            a = builder.select(condition, a, ir.Constant(a.type, None))
        f = of_lanes(builder, "fmuladd", a, b, c)
        return builder.select(condition, f, c) if masked else f

    return a(condition, a, b, c), codegen


@intrinsic
def select(typingctx, condition, a, b):
    """a where the mask is set, else b. Each a vector or a float32."""

    def codegen(context, builder, sig, args):
        lanes = sig.return_type.lanes
        return builder.select(args[0], *(_as_vector(builder, x, lanes) for x in args[1:]))

    kind = _widest(a, b)
    return (kind(condition, a, b), codegen) if kind else None


@intrinsic
def movemask(typingctx, condition):
    """The mask as an integer: lane k is bit k."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(args[0].type.count)), I32)

    return types.uint32(condition), codegen


@intrinsic
def ctz(typingctx, x):
    """Count of trailing zeros of a uint32 or uint64: the index of its lowest set bit; x must not be 0."""

    def codegen(context, builder, sig, args):
        kind = args[0].type
        f = declare(builder, f"llvm.cttz.{kind}", kind, [kind, ir.IntType(1)])
        found = builder.call(f, [args[0], ir.Constant(ir.IntType(1), 1)])
        return found if kind == I64 else builder.zext(found, I64)

    return types.int64(x), codegen


@intrinsic
def popcount(typingctx, x):
    """The number of set bits of a uint32."""

    def codegen(context, builder, sig, args):
        return builder.call(declare(builder, "llvm.ctpop.i32", I32, [I32]), args)

    return types.uint32(types.uint32), codegen


@intrinsic
def with_avx512(typingctx):
    """`has_avx512` as a constant of the code."""
    return types.boolean(), lambda context, builder, sig, args: ir.Constant(
        ir.IntType(1), int(has_avx512(context))
    )


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
    """Return which of 32 masks of pixels, from the index-th of an address on, are not empty: a bit a mask."""

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
