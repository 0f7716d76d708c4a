"""Sixteen float32 as a numba type, its operators and masks.

The type is LLVM's <16 x float>: one register with AVX-512, two with AVX2, four with SSE or NEON. `a * b + c` is not
fused; `fma` is, where the processor can.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 16
F32, I32, I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
I16 = ir.IntType(LANES)
FV, IV, MV = (ir.VectorType(t, LANES) for t in (F32, I32, ir.IntType(1)))


class _Vector(types.Type):
    """Sixteen float32."""

    def __init__(self) -> None:
        super().__init__(name="Float32x16")


class _Mask(types.Type):
    """Sixteen truth values."""

    def __init__(self) -> None:
        super().__init__(name="Mask16")


vector, mask = _Vector(), _Mask()


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, FV)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, MV)


def constant_lanes(lanes):
    """The mask operand of a shuffle."""
    picked = [ir.Constant(I32, k) for k in lanes]
    return ir.Constant(ir.VectorType(I32, len(picked)), picked)


def as_lanes(builder, scalar):
    """A float32 or an integer of 32 bits in every lane."""
    kind = FV if scalar.type == F32 else IV
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), scalar, ir.Constant(I32, 0))
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), constant_lanes([0] * LANES))


def _as_vector(builder, value):
    return value if value.type == FV else as_lanes(builder, value)


def _register(op, result, emit):
    @infer_global(op)
    class _Operator(ConcreteTemplate):
        cases = [signature(result, a, b) for a, b in _PAIRS]  # noqa: RUF012

    for a, b in _PAIRS:

        @lower_builtin(op, a, b)
        def lower(context, builder, sig, args):
            return emit(builder, *(_as_vector(builder, x) for x in args))


_PAIRS = ((vector, vector), (vector, types.float32), (types.float32, vector))
_register(operator.add, vector, lambda b, x, y: b.fadd(x, y))
_register(operator.sub, vector, lambda b, x, y: b.fsub(x, y))
_register(operator.mul, vector, lambda b, x, y: b.fmul(x, y))
# a reciprocal with one step of Newton's method where the processor has one: 1 to 2 units in the last place
_register(
    operator.truediv, vector, lambda b, x, y: b.fdiv(x, y, flags=("arcp", "afn", "ninf", "nnan", "contract"))
)
_register(min, vector, lambda b, x, y: b.select(b.fcmp_ordered("<", x, y), x, y))
_register(max, vector, lambda b, x, y: b.select(b.fcmp_ordered(">", x, y), x, y))
_register(operator.gt, mask, lambda b, x, y: b.fcmp_ordered(">", x, y))
_register(operator.ge, mask, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_register(operator.lt, mask, lambda b, x, y: b.fcmp_ordered("<", x, y))
_register(operator.le, mask, lambda b, x, y: b.fcmp_ordered("<=", x, y))
_register(operator.eq, mask, lambda b, x, y: b.fcmp_ordered("==", x, y))


@infer_global(operator.neg)
class _Negative(ConcreteTemplate):
    cases = [signature(vector, vector)]  # noqa: RUF012


@lower_builtin(operator.neg, vector)
def _negative(context, builder, sig, args):
    return builder.fneg(args[0])


@infer_global(abs)
class _Magnitude(ConcreteTemplate):
    cases = [signature(vector, vector)]  # noqa: RUF012


@lower_builtin(abs, vector)
def _magnitude(context, builder, sig, args):
    return builder.call(declare(builder, "llvm.fabs.v16f32", FV, [FV]), args)


@infer_global(operator.and_)
class _And(ConcreteTemplate):
    cases = [signature(mask, mask, mask)]  # noqa: RUF012


@lower_builtin(operator.and_, mask, mask)
def _and(context, builder, sig, args):
    return builder.and_(*args)


def declare(builder, name, result, arguments):
    return cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, arguments), name)


@intrinsic
def broadcast(typingctx, x):
    """A float32 in all lanes."""
    return vector(types.float32), lambda context, builder, sig, args: as_lanes(builder, args[0])


@intrinsic
def fma(typingctx, a, b, c):
    """a · b + c, rounded once where the processor can. Each a vector or a float32."""

    def codegen(context, builder, sig, args):
        f = declare(builder, "llvm.fmuladd.v16f32", FV, [FV] * 3)
        return builder.call(f, [_as_vector(builder, x) for x in args])

    return vector(a, b, c), codegen


@intrinsic
def fma_where(typingctx, condition, a, b, c):
    """a · b + c where the mask is set, else c; a a vector, b finite.

    AVX-512 masks the instruction itself. Elsewhere a is set to 0, once for all calls with the same mask and a.
    """

    def codegen(context, builder, sig, args):
        condition, a, b, c = args[0], *(_as_vector(builder, x) for x in args[1:])
        masked = has_avx512(context)
        if not masked:
            a = builder.select(condition, a, ir.Constant(FV, None))
        f = builder.call(declare(builder, "llvm.fmuladd.v16f32", FV, [FV] * 3), [a, b, c])
        return builder.select(condition, f, c) if masked else f

    return vector(condition, vector, b, c), codegen


@intrinsic
def select(typingctx, condition, a, b):
    """a where the mask is set, else b. Each a vector or a float32."""

    def codegen(context, builder, sig, args):
        return builder.select(args[0], _as_vector(builder, args[1]), _as_vector(builder, args[2]))

    return vector(mask, a, b), codegen


@intrinsic
def movemask(typingctx, condition):
    """The mask as an integer: lane k is bit k."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), I32)

    return types.uint32(mask), codegen


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


def has_avx512(context):
    """Whether the target has AVX-512 (DQ): 32-entry look-ups, masked arithmetic, `vreduceps`."""
    return "+avx512dq" in context.codegen().magic_tuple()[2]


@intrinsic
def with_avx512(typingctx):
    """`has_avx512` as a constant of the code."""
    return types.boolean(), lambda context, builder, sig, args: ir.Constant(
        ir.IntType(1), int(has_avx512(context))
    )
