"""Functions of vectors: exp2, and math's sqrt, log, ceil and floor."""

import math

import numpy as np
from llvmlite import ir
from numba.core import cgutils

from tg4mm.fit.rasterize.simd.vector import (
    FV,
    I16,
    I32,
    IV,
    LANES,
    declare,
    has_avx512,
    instruction,
    of_lanes,
    register,
    vector,
)

# of `vreduceps`: round to nearest, suppress the inexact exception; exception mode as set
_QUIET, _AS_SET = 8, 4
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
_HALF_ROOT = 0x3F3504F3  # the bits of √½
# (ln(1 + f) - f + f²/2) / f³ for √½ <= 1 + f < √2, least error relative to ln(1 + f), 3.2e-8, as above
_LOGARITHM = [0.0870043039, -0.142674863, 0.149147689, -0.16577585, 0.199630633, -0.250013381, 0.333339095]
_LN2 = 0.693359375  # to ten binary digits, so that n times it is exact
_LN2_REST = float(np.log(2)) - _LN2


def _exp2_series(builder, x, constants):
    *polynomial, rounder = constants
    shifted = builder.fadd(x, rounder)
    f = builder.fsub(x, builder.fsub(shifted, rounder))
    # by pairs of terms (Estrin): a chain of three multiply-adds instead of five
    square = builder.fmul(f, f)
    pairs = [of_lanes(builder, "fmuladd", polynomial[k], f, polynomial[k + 1]) for k in (0, 2, 4)]
    p = of_lanes(
        builder, "fmuladd", of_lanes(builder, "fmuladd", pairs[0], square, pairs[1]), square, pairs[2]
    )
    words = ir.VectorType(I32, x.type.count)
    n = builder.shl(
        builder.bitcast(shifted, words), ir.Constant(words, [ir.Constant(I32, 23)] * x.type.count)
    )
    return builder.bitcast(builder.add(builder.bitcast(p, words), n), x.type)


def _exp2_steps(builder, x, constants, steps):
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
    rise = builder.fmul(of_lanes(builder, "fmuladd", second, f, first), f)
    return of_lanes(builder, "fmuladd", power, rise, power)


@instruction(lambda x, constants: x(x, constants))
def exp2(context, builder, sig, args):
    """2^x for -126 <= x <= 0; below, any value. Relative error below 3e-7. constants: EXP2 and EXP2_STEPS, vectors.

    2^n · 2^f with n the nearest integer and |f| <= 1/2, a polynomial for 2^f. The low bits of x + 1.5 · 2^23 are n.
    For sixteen lanes with AVX-512 n is the nearest multiple of 1/32, whose power is looked up, and the polynomial takes
    three multiplications instead of five.
    """
    values = cgutils.unpack_tuple(builder, args[1])
    series, short, steps = values[: len(_SERIES)], values[len(_SERIES) : len(EXP2)], values[len(EXP2) :]
    if has_avx512(context) and sig.return_type == vector:
        return _exp2_steps(builder, args[0], short, steps)
    return _exp2_series(builder, args[0], series)


def _logarithm(builder, x):
    """The logarithm of positive normal numbers; error below 2e-7 of it.

    n ln 2 + ln(1 + f) with x = 2^n (1 + f), √½ <= 1 + f < √2, a polynomial for the latter.
    """

    def of(kind, number):
        return ir.Constant(kind, [ir.Constant(kind.element, number)] * LANES)

    x = builder.bitcast(x, IV)
    n = builder.ashr(builder.sub(x, of(IV, _HALF_ROOT)), of(IV, 23))
    f = builder.bitcast(builder.sub(x, builder.shl(n, of(IV, 23))), FV)
    f, n = builder.fsub(f, of(FV, 1.0)), builder.sitofp(n, FV)
    series = of(FV, _LOGARITHM[0])
    for coefficient in _LOGARITHM[1:]:
        series = of_lanes(builder, "fmuladd", series, f, of(FV, coefficient))
    square = builder.fmul(f, f)
    small = builder.fmul(n, of(FV, _LN2_REST))
    small = of_lanes(builder, "fmuladd", builder.fmul(square, f), series, small)
    small = of_lanes(builder, "fmuladd", square, of(FV, -0.5), small)
    return of_lanes(builder, "fmuladd", n, of(FV, _LN2), builder.fadd(small, f))


for _function, _lower in (
    (math.sqrt, lambda b, x: of_lanes(b, "sqrt", x)),  # rounded as it should be
    (math.log, _logarithm),
    (math.ceil, lambda b, x: of_lanes(b, "ceil", x)),  # whole numbers as float32
    (math.floor, lambda b, x: of_lanes(b, "floor", x)),
):
    register(_function, [(vector, vector)], _lower)
