"""Sixteen float32 side by side as a numba type: a kernel says itself what one vector instruction does.

LLVM's loop vectoriser decides by the shape of a loop and checks for aliasing; here nothing is left to decide. The
type is LLVM's <16 x float>: one register with AVX-512, two with AVX2, four with SSE or NEON. `a * b + c` is not
fused; `fma` is, where the processor can. No operation depends on the order of threads.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 16
F32, I32, I64 = ir.FloatType(), ir.IntType(32), ir.IntType(64)
I16 = ir.IntType(LANES)
# of `vreduceps`: to the nearest without saying that it is inexact; exceptions as they are set
_QUIET, _AS_SET = 8, 4
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
    """Which lanes a shuffle takes."""
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
_register(operator.gt, mask, lambda b, x, y: b.fcmp_ordered(">", x, y))
_register(operator.ge, mask, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_register(operator.lt, mask, lambda b, x, y: b.fcmp_ordered("<", x, y))


@infer_global(operator.and_)
class _And(ConcreteTemplate):
    cases = [signature(mask, mask, mask)]  # noqa: RUF012


@lower_builtin(operator.and_, mask, mask)
def _and(context, builder, sig, args):
    return builder.and_(*args)


def declare(builder, name, result, arguments):
    return cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, arguments), name)


@intrinsic
def wide(typingctx, x):
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
def negative(typingctx, a):
    """-a."""
    return vector(vector), lambda context, builder, sig, args: builder.fneg(args[0])


@intrinsic
def magnitude(typingctx, a):
    """|a|."""

    def codegen(context, builder, sig, args):
        return builder.call(declare(builder, "llvm.fabs.v16f32", FV, [FV]), args)

    return vector(vector), codegen


@intrinsic
def select(typingctx, condition, a, b):
    """a where the mask is set, else b. Each a vector or a float32."""

    def codegen(context, builder, sig, args):
        return builder.select(args[0], _as_vector(builder, args[1]), _as_vector(builder, args[2]))

    return vector(mask, a, b), codegen


@intrinsic
def bits(typingctx, condition):
    """The mask as an integer: lane k is bit k."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), I32)

    return types.uint32(mask), codegen


@intrinsic
def lowest_bit(typingctx, x):
    """The index of the lowest bit of a uint32 or uint64 that is set; x must not be 0."""

    def codegen(context, builder, sig, args):
        kind = args[0].type
        f = declare(builder, f"llvm.cttz.{kind}", kind, [kind, ir.IntType(1)])
        found = builder.call(f, [args[0], ir.Constant(ir.IntType(1), 1)])
        return found if kind == I64 else builder.zext(found, I64)

    return types.int64(x), codegen


@intrinsic
def number_of_bits(typingctx, x):
    """How many bits of a uint32 are set."""

    def codegen(context, builder, sig, args):
        return builder.call(declare(builder, "llvm.ctpop.i32", I32, [I32]), args)

    return types.uint32(types.uint32), codegen


# 2^f for |f| <= 1/2, least relative error, 1.2e-7, by iterated weighted least squares; last, what rounds a float32 by
# being added to it: the sum's last binary digit is worth 1
_SERIES = [0.00132764704, 0.00967554162, 0.0555071328, 0.240221197, 0.693146967, 1.0, 1.5 * 2**23]
# 2^f - 1 over f for |f| <= 1/64, alike, 5e-8; what rounds to 1/32
_STEP_BITS = 5
_STEP = 1 << _STEP_BITS
_SHORT_SERIES = [0.240226496, 0.693157335, 1.5 * 2**23 / _STEP]
EXP2 = np.array(_SERIES + _SHORT_SERIES, np.float32)
# 2^(k/32), two vectors; of their bits, as integers, is taken off what k itself adds when n + k/32 is shifted
_PLACES = np.arange(_STEP, dtype=np.int32)
EXP2_STEPS = (
    (2.0 ** (_PLACES / _STEP)).astype(np.float32).view(np.int32) - (_PLACES << 23 - _STEP_BITS)
).view(np.float32)


def has_avx512(context):
    """Is the code for a processor that looks up 32 numbers at once, masks what it calculates and has `vreduceps`?"""
    return "+avx512dq" in context.codegen().magic_tuple()[2]


@intrinsic
def with_avx512(typingctx):
    """`has_avx512` as a constant of the code."""
    return types.boolean(), lambda context, builder, sig, args: ir.Constant(
        ir.IntType(1), int(has_avx512(context))
    )


def _exp2_series(builder, x, multiply_add, constants):
    *polynomial, rounder = constants
    shifted = builder.fadd(x, rounder)
    f = builder.fsub(x, builder.fsub(shifted, rounder))
    p = polynomial[0]
    for coefficient in polynomial[1:]:
        p = builder.call(multiply_add, [p, f, coefficient])
    shift = ir.Constant(IV, [ir.Constant(I32, 23)] * LANES)
    return p, builder.shl(builder.bitcast(shifted, IV), shift)


def _exp2_steps(builder, x, multiply_add, constants, steps):
    second, first, rounder = constants
    shifted = builder.fadd(x, rounder)
    reduce = declare(builder, "llvm.x86.avx512.mask.reduce.ps.512", FV, [FV, I32, FV, I16, I32])
    # x less its nearest multiple of 2^-_STEP_BITS, in all lanes; of two as near the even one, as adding `rounder` takes
    f = builder.call(
        reduce,
        [x, ir.Constant(I32, _STEP_BITS << 4 | _QUIET), x, ir.Constant(I16, -1), ir.Constant(I32, _AS_SET)],
    )
    look_up = declare(builder, "llvm.x86.avx512.vpermi2var.ps.512", FV, [FV, IV, FV])
    n = builder.bitcast(shifted, IV)
    step = builder.call(look_up, [steps[0], n, steps[1]])  # by the last five bits
    shift = ir.Constant(IV, [ir.Constant(I32, 23 - _STEP_BITS)] * LANES)
    power = builder.bitcast(builder.add(builder.bitcast(step, IV), builder.shl(n, shift)), FV)
    rise = builder.fmul(builder.call(multiply_add, [second, f, first]), f)
    return builder.call(multiply_add, [power, rise, power])


@intrinsic
def exp2(typingctx, x, constants):
    """2^x for -126 <= x <= 0; below, any value. Relative error below 3e-7. constants: EXP2 and EXP2_STEPS, vectors.

    2^n · 2^f with n the nearest integer and |f| <= 1/2, a polynomial for 2^f. The low bits of x + 1.5 · 2^23 are n.
    With AVX-512 it is the nearest 1/32, whose fraction is looked up, and the rest takes three multiplications instead
    of five: of those blending has most.
    """

    def codegen(context, builder, sig, args):
        values = cgutils.unpack_tuple(builder, args[1])
        series, short, steps = values[: len(_SERIES)], values[len(_SERIES) : len(EXP2)], values[len(EXP2) :]
        multiply_add = declare(builder, "llvm.fmuladd.v16f32", FV, [FV] * 3)
        if has_avx512(context):
            return _exp2_steps(builder, args[0], multiply_add, short, steps)
        p, n = _exp2_series(builder, args[0], multiply_add, series)
        return builder.bitcast(builder.add(builder.bitcast(p, IV), n), FV)

    return vector(vector, constants), codegen
