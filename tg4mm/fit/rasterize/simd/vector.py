"""Sixteen float32, and eight, as numba types, their operators and masks.

The types are LLVM's <16 x float> (`vector`: one register with AVX-512, two with AVX2, four with SSE or NEON) and
<8 x float> (`half`). `a * b + c` is not fused; `fma` is, where the processor can.

`pixels` is the one of the two that blending works on, a lane a pixel: `vector` with AVX-512, `half` elsewhere, where
there are but sixteen registers, narrower ones, and the state of sixteen pixels does not fit into them.

Masks of lanes lie in memory as a bit each; sixteen words of 32 bits are a vector that is not read as float32.
"""

import inspect
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
    """Return whether the target has AVX-512 (DQ): 32-entry look-ups, masked arithmetic, `vreduceps`."""
    return "+avx512dq" in context.codegen().magic_tuple()[2]


def instruction(typed):
    """Return a decorator that makes a code generator a function for kernels (numba's `intrinsic`).

    `typed` maps the types of the arguments to the signature, or None. The generator of a tuple returns its items.
    """

    def decorate(generate):
        def lower(context, builder, sig, args):
            found = generate(context, builder, sig, args)
            if sig.return_type is types.none:
                return context.get_dummy_value()
            is_tuple = isinstance(sig.return_type, types.BaseTuple)
            return context.make_tuple(builder, sig.return_type, found) if is_tuple else found

        def definition(typingctx, *kinds):
            return (found, lower) if (found := typed(*kinds)) else None

        parameters = inspect.signature(typed).parameters.values()
        context = inspect.Parameter("typingctx", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        definition.__signature__ = inspect.Signature([context, *parameters])  # type: ignore[attr-defined]
        definition.__name__, definition.__doc__ = generate.__name__, generate.__doc__
        return intrinsic(definition)

    return decorate


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


def in_a_row(builder, parts):
    """Vectors, a power of two of them, as one."""
    while len(parts) > 1:
        lanes = constant_lanes(range(2 * parts[0].type.count))
        parts = [builder.shuffle_vector(*parts[k : k + 2], lanes) for k in range(0, len(parts), 2)]
    return parts[0]


def _as_vector(builder, value, lanes):
    return value if isinstance(value.type, ir.VectorType) else as_lanes(builder, value, lanes)


def _widest(*kinds):
    """Return the vector type among the types of arguments; None where there are two, or none."""
    found = {kind for kind in kinds if isinstance(kind, Vector)}
    return found.pop() if len(found) == 1 else None


def register(op, of_types, emit):
    """Let kernels call `op` on vectors: `emit` makes its code, for each of the types (result, arguments …)."""

    @infer_global(op)
    class _Operator(ConcreteTemplate):
        cases = [signature(*case) for case in of_types]  # noqa: RUF012

    for _, *arguments in of_types:

        @lower_builtin(op, *arguments)
        def lower(context, builder, sig, args):
            lanes = sig.return_type.lanes
            return emit(builder, *(_as_vector(builder, x, lanes) for x in args))


_ONE = [(kind, kind) for kind in mask_of]
_TWO = [
    (kind, *two) for kind in mask_of for two in ((kind, kind), (kind, types.float32), (types.float32, kind))
]
_COMPARED = [(mask_of[kind], *two) for kind, *two in _TWO]
register(operator.add, _TWO, lambda b, x, y: b.fadd(x, y))
register(operator.sub, _TWO, lambda b, x, y: b.fsub(x, y))
register(operator.mul, _TWO, lambda b, x, y: b.fmul(x, y))
# a reciprocal with one step of Newton's method where the processor has one: 1 to 2 units in the last place
register(
    operator.truediv, _TWO, lambda b, x, y: b.fdiv(x, y, flags=("arcp", "afn", "ninf", "nnan", "contract"))
)
register(min, _TWO, lambda b, x, y: b.select(b.fcmp_ordered("<", x, y), x, y))
register(max, _TWO, lambda b, x, y: b.select(b.fcmp_ordered(">", x, y), x, y))
register(operator.gt, _COMPARED, lambda b, x, y: b.fcmp_ordered(">", x, y))
register(operator.ge, _COMPARED, lambda b, x, y: b.fcmp_ordered(">=", x, y))
register(operator.lt, _COMPARED, lambda b, x, y: b.fcmp_ordered("<", x, y))
register(operator.le, _COMPARED, lambda b, x, y: b.fcmp_ordered("<=", x, y))
register(operator.eq, _COMPARED, lambda b, x, y: b.fcmp_ordered("==", x, y))
register(operator.neg, _ONE, lambda b, x: b.fneg(x))
register(abs, _ONE, lambda b, x: of_lanes(b, "fabs", x))
register(operator.and_, [(kind, kind, kind) for kind in mask_of.values()], lambda b, x, y: b.and_(x, y))


def declare(builder, name, result, arguments):
    """Return the external function `name` of the module that is being built, declared if it is not yet."""
    return cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, arguments), name)


def of_lanes(builder, name, *args):
    """LLVM's function `name` of vectors of one type: fmuladd, fabs, sqrt and others."""
    kind = args[0].type
    return builder.call(declare(builder, f"llvm.{name}.v{kind.count}f32", kind, [kind] * len(args)), args)


def _broadcasting(kind):
    @instruction(lambda x: kind(types.float32))
    def broadcasting(context, builder, sig, args):
        return as_lanes(builder, args[0], kind.lanes)

    return broadcasting


broadcast = _broadcasting(vector)  # a float32 in all lanes
broadcast_half = _broadcasting(half)
broadcast_pixels = broadcast if pixels == vector else broadcast_half


@instruction(lambda a, b, c: (kind := _widest(a, b, c)) and kind(a, b, c))
def fma(context, builder, sig, args):
    """a · b + c, rounded once where the processor can. Each a vector or a float32."""
    lanes = sig.return_type.lanes
    return of_lanes(builder, "fmuladd", *(_as_vector(builder, x, lanes) for x in args))


@instruction(lambda condition, a, b, c: a(condition, a, b, c))
def fma_where(context, builder, sig, args):
    """a · b + c where the mask is set, else c; a a vector, b finite.

    AVX-512 masks the instruction itself. Elsewhere a is set to 0, once for all calls with the same mask and a.
    """
    lanes = sig.return_type.lanes
    condition, a, b, c = args[0], *(_as_vector(builder, x, lanes) for x in args[1:])
    masked = has_avx512(context)
    if not masked:
        a = builder.select(condition, a, ir.Constant(a.type, None))
    f = of_lanes(builder, "fmuladd", a, b, c)
    return builder.select(condition, f, c) if masked else f


@instruction(lambda condition, a, b: (kind := _widest(a, b)) and kind(condition, a, b))
def select(context, builder, sig, args):
    """a where the mask is set, else b. Each a vector or a float32."""
    lanes = sig.return_type.lanes
    return builder.select(args[0], *(_as_vector(builder, x, lanes) for x in args[1:]))


@instruction(lambda condition: types.uint32(condition))
def movemask(context, builder, sig, args):
    """The mask as an integer: lane k is bit k."""
    return builder.zext(builder.bitcast(args[0], ir.IntType(args[0].type.count)), I32)


@instruction(lambda x: types.int64(x))
def ctz(context, builder, sig, args):
    """Count of trailing zeros of a uint32 or uint64: the index of its lowest set bit; x must not be 0."""
    kind = args[0].type
    f = declare(builder, f"llvm.cttz.{kind}", kind, [kind, ir.IntType(1)])
    found = builder.call(f, [args[0], ir.Constant(ir.IntType(1), 1)])
    return found if kind == I64 else builder.zext(found, I64)


@instruction(lambda x: types.uint32(types.uint32))
def popcount(context, builder, sig, args):
    """The number of set bits of a uint32."""
    return builder.call(declare(builder, "llvm.ctpop.i32", I32, [I32]), args)


@instruction(lambda: types.boolean())
def with_avx512(context, builder, sig, args):
    """`has_avx512` as a constant of the code."""
    return ir.Constant(ir.IntType(1), int(has_avx512(context)))


@instruction(lambda at, index, condition: types.none(types.int64, types.int64, condition))
def put_mask(context, builder, sig, args):
    """Write a mask as the index-th of such masks from an address on."""
    bits = ir.IntType(args[2].type.count)
    at = builder.gep(builder.inttoptr(args[0], bits.as_pointer()), [args[1]])
    builder.store(builder.bitcast(args[2], bits), at, align=1)


@instruction(lambda at, index, a, b, c, d: types.none(types.int64, types.int64, a, b, c, d))
def put_four_masks(context, builder, sig, args):
    """Write four masks one behind the other as the index-th four of such masks from an address on."""
    bits = ir.IntType(4 * args[2].type.count)
    at = builder.gep(builder.inttoptr(args[0], bits.as_pointer()), [args[1]])
    builder.store(builder.bitcast(in_a_row(builder, args[2:]), bits), at, align=1)


@instruction(lambda at, low, high: vector(types.int64, types.int64, types.int64))
def two_halves(context, builder, sig, args):
    """Sixteen words of 32 bits of low and high halves, sixteen each, from the low-th and high-th of an address on."""
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


@instruction(lambda at, index: types.uint32(types.int64, types.int64))
def not_empty(context, builder, sig, args):
    """Return which of 32 masks of pixels, from the index-th of an address on, are not empty: a bit a mask."""
    bits = ir.IntType(PIXELS)
    kind = ir.VectorType(bits, 2 * LANES)
    data = builder.gep(builder.inttoptr(args[0], bits.as_pointer()), [args[1]])
    masks = builder.load(builder.bitcast(data, kind.as_pointer()), align=1)
    return builder.bitcast(builder.icmp_unsigned("!=", masks, ir.Constant(kind, None)), I32)


@instruction(lambda words, by: vector(vector, types.uint32))
def shifted(context, builder, sig, args):
    """Sixteen times 32 bits, each shifted to the left."""
    return builder.bitcast(builder.shl(builder.bitcast(args[0], IV), as_lanes(builder, args[1])), FV)


@instruction(lambda words: types.uint32(vector))
def sign_mask(context, builder, sig, args):
    """Mask, as an integer, of those of sixteen times 32 bits that have the highest bit set."""
    lanes = builder.icmp_signed("<", builder.bitcast(args[0], IV), ir.Constant(IV, None))
    return builder.zext(builder.bitcast(lanes, I16), I32)


@instruction(lambda at, index, bits, base: types.none(types.int64, types.int64, types.uint32, types.uint32))
def put_places(context, builder, sig, args):
    """Write base + k for each bit k of `movemask` that is set, then zeros: sixteen uint32, from the index-th on."""
    at, index, bits, base = args
    chosen = builder.bitcast(builder.trunc(bits, I16), MV)
    f = declare(builder, "llvm.experimental.vector.compress.v16i32", IV, [IV, MV, IV])
    places = builder.call(f, [builder.add(_NUMBERED, as_lanes(builder, base)), chosen, ir.Constant(IV, None)])
    data = builder.gep(builder.inttoptr(at, I32.as_pointer()), [index])
    builder.store(places, builder.bitcast(data, IV.as_pointer()), align=4)


@instruction(lambda value, count, other: vector(vector, types.int64, types.float32))
def first_lanes(context, builder, sig, args):
    """The first `count` lanes of a vector, then those of another, or a float32."""
    value, count, other = args
    there = builder.icmp_unsigned("<", _NUMBERED, as_lanes(builder, builder.trunc(count, I32)))
    return builder.select(there, value, as_lanes(builder, other))
