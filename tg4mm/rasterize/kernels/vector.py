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
_F32, _I32 = ir.FloatType(), ir.IntType(32)
_FV, _IV, _MV = (ir.VectorType(t, LANES) for t in (_F32, _I32, ir.IntType(1)))


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
        super().__init__(manager, kind, _FV)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _MV)


def _wide(builder, scalar):
    """A float32 in every lane."""
    one = builder.insert_element(ir.Constant(_FV, ir.Undefined), scalar, ir.Constant(_I32, 0))
    lanes = ir.Constant(ir.VectorType(_I32, LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_FV, ir.Undefined), lanes)


def _as_vector(builder, value):
    return value if value.type == _FV else _wide(builder, value)


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
_register(operator.truediv, vector, lambda b, x, y: b.fdiv(x, y, flags=("arcp", "afn", "ninf", "nnan")))
_register(operator.gt, mask, lambda b, x, y: b.fcmp_ordered(">", x, y))
_register(operator.ge, mask, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_register(operator.lt, mask, lambda b, x, y: b.fcmp_ordered("<", x, y))


@infer_global(operator.and_)
class _And(ConcreteTemplate):
    cases = [signature(mask, mask, mask)]  # noqa: RUF012


@lower_builtin(operator.and_, mask, mask)
def _and(context, builder, sig, args):
    return builder.and_(*args)


def _declare(builder, name, result, arguments):
    return cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, arguments), name)


@intrinsic
def wide(typingctx, x):
    """A float32 in all lanes."""
    return vector(types.float32), lambda context, builder, sig, args: _wide(builder, args[0])


@intrinsic
def fma(typingctx, a, b, c):
    """a · b + c, rounded once where the processor can. Each a vector or a float32."""

    def codegen(context, builder, sig, args):
        f = _declare(builder, "llvm.fmuladd.v16f32", _FV, [_FV] * 3)
        return builder.call(f, [_as_vector(builder, x) for x in args])

    return vector(a, b, c), codegen


@intrinsic
def negative(typingctx, a):
    """-a."""
    return vector(vector), lambda context, builder, sig, args: builder.fneg(args[0])


@intrinsic
def magnitude(typingctx, a):
    """|a|."""

    def codegen(context, builder, sig, args):
        return builder.call(_declare(builder, "llvm.fabs.v16f32", _FV, [_FV]), args)

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
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), _I32)

    return types.uint32(mask), codegen


@intrinsic
def lowest_bit(typingctx, x):
    """The index of the lowest bit that is set; x must not be 0."""

    def codegen(context, builder, sig, args):
        f = _declare(builder, "llvm.cttz.i32", _I32, [_I32, ir.IntType(1)])
        return builder.zext(builder.call(f, [args[0], ir.Constant(ir.IntType(1), 1)]), ir.IntType(64))

    return types.int64(types.uint32), codegen


def _address(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _FV.as_pointer())


@intrinsic
def load(typingctx, array, index):
    """Lanes from the contiguous float32 array [n], from the int64 `index` on, which is not checked."""

    def codegen(context, builder, sig, args):
        return builder.load(_address(context, builder, sig.args[0], *args), align=4)

    return vector(array, types.int64), codegen


@intrinsic
def store(typingctx, array, index, value):
    """Lanes to the contiguous float32 array [n], from the int64 `index` on, which is not checked."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], _address(context, builder, sig.args[0], *args[:2]), align=4)
        return context.get_dummy_value()

    return types.none(array, types.int64, vector), codegen


# least relative error on |f| <= 1/2, 1.2e-7, by iterated weighted least squares
_EXP2 = (0.00132764704, 0.00967554162, 0.0555071328, 0.240221197, 0.693146967, 1.0)


@intrinsic
def exp2(typingctx, x):
    """2^x for -126 <= x <= 0; below, any value. Relative error below 3e-7.

    2^n · 2^f with n the nearest integer and |f| <= 1/2, a polynomial for 2^f.
    """

    def codegen(context, builder, sig, args):
        def constant(value):
            return ir.Constant(_FV, [ir.Constant(_F32, float(np.float32(value)))] * LANES)

        x = args[0]
        # truncation of a negative number less a half: the nearest integer
        n = builder.fptosi(builder.fsub(x, constant(0.5)), _IV)
        f = builder.fsub(x, builder.sitofp(n, _FV))
        multiply_add = _declare(builder, "llvm.fmuladd.v16f32", _FV, [_FV] * 3)
        p = constant(_EXP2[0])
        for coefficient in _EXP2[1:]:
            p = builder.call(multiply_add, [p, f, constant(coefficient)])
        shift = ir.Constant(_IV, [ir.Constant(_I32, 23)] * LANES)
        return builder.bitcast(builder.add(builder.bitcast(p, _IV), builder.shl(n, shift)), _FV)

    return vector(vector), codegen


def _fold(builder, a, b):
    """Sums of neighbouring lanes: those of a in the lower half, those of b in the upper."""
    lanes = [ir.Constant(_IV, [ir.Constant(_I32, 2 * k + odd) for k in range(LANES)]) for odd in (0, 1)]
    return builder.fadd(*(builder.shuffle_vector(a, b, pick) for pick in lanes))


def _lane_sums(builder, parts):
    """One vector whose first lanes are the sums of the lanes of each part (at most 16), by a fixed tree."""
    parts = list(parts) + [parts[-1]] * (LANES - len(parts))
    while len(parts) > 1:
        half: list[ir.Value] = []
        for k in range(0, len(parts), 2):
            same = half and parts[k] is parts[k - 2] and parts[k + 1] is parts[k - 1]
            half.append(half[-1] if same else _fold(builder, parts[k], parts[k + 1]))
        parts = half
    return parts[0]


@intrinsic
def lane_sums(typingctx, a, b, c, d, e, f, g, h, i, j):
    """The sum of the lanes of each of ten vectors, in lanes 0 … 9 of one. Always added in the same order."""
    return vector(*[vector] * 10), lambda context, builder, sig, args: _lane_sums(builder, args)


@intrinsic
def lane_sums_of_eight(typingctx, a, b, c, d, e, f, g, h):
    """`lane_sums` of eight vectors, in lanes 0 … 7."""
    return vector(*[vector] * 8), lambda context, builder, sig, args: _lane_sums(builder, args)


def _store_parts(context, builder, sig, args, parts):
    """Store the lanes first … first + count for each of `parts`."""
    data = context.make_array(sig.args[0])(context, builder, args[0]).data
    for first, count in parts:
        kind = ir.VectorType(_F32, count)
        lanes = ir.Constant(ir.VectorType(_I32, count), [ir.Constant(_I32, first + k) for k in range(count)])
        part = builder.shuffle_vector(args[2], args[2], lanes)
        place = builder.gep(data, [builder.add(args[1], ir.Constant(ir.IntType(64), first))])
        builder.store(part, builder.bitcast(place, kind.as_pointer()), align=4)
    return context.get_dummy_value()


@intrinsic
def store_ten(typingctx, array, index, value):
    """Lanes 0 … 9 to the contiguous float32 array [n]."""

    def codegen(context, builder, sig, args):
        return _store_parts(context, builder, sig, args, ((0, 8), (8, 2)))

    return types.none(array, types.int64, vector), codegen


@intrinsic
def store_eight(typingctx, array, index, value):
    """Lanes 0 … 7 to the contiguous float32 array [n]."""

    def codegen(context, builder, sig, args):
        return _store_parts(context, builder, sig, args, ((0, 8),))

    return types.none(array, types.int64, vector), codegen


@intrinsic
def fetch_add(typingctx, array):
    """Add 1 to the first entry of an int64 array and return what it was, atomically: a thread takes its next item."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", data, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(array), codegen


@intrinsic
def prefetch(typingctx, array, row):
    """Ask for the first cache line of a row of the C-ordered array [n, m] ahead of its use."""

    def codegen(context, builder, sig, args):
        made = context.make_array(sig.args[0])(context, builder, args[0])
        stride = builder.extract_value(made.strides, 0)
        address = builder.add(builder.ptrtoint(made.data, ir.IntType(64)), builder.mul(args[1], stride))
        kind = ir.IntType(8).as_pointer()
        f = _declare(builder, "llvm.prefetch.p0", ir.VoidType(), [kind, _I32, _I32, _I32])
        hints = [ir.Constant(_I32, x) for x in (0, 3, 1)]  # to read, keep, data
        builder.call(f, [builder.inttoptr(address, kind), *hints])
        return context.get_dummy_value()

    return types.none(array, types.int64), codegen
