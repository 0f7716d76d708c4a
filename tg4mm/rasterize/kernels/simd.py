"""Scalar helpers that LLVM can vectorise: an exponential without a library call."""

from llvmlite import ir
from numba import float32, int32, njit, types
from numba.extending import intrinsic


@intrinsic
def _bits_to_float(typingctx, bits):
    """Reinterpret an int32 as the float32 with the same bits."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.FloatType())

    return types.float32(types.int32), codegen


@njit(fastmath=True, inline="always")
def exp_neg(x):
    """e^(-x) for 0 <= x <= 80, float32, relative error below 4e-6 (7e-7 where x < 6, all blending uses).

    2^n · 2^f with n the nearest integer and |f| <= 1/2; the polynomial is the Taylor series of 2^f to
    order 6.
    """
    y = x * float32(-1.4426950408889634)
    n = int32(y - float32(0.5))  # truncation of a negative number: the nearest integer
    f = y - float32(n)
    p = float32(1.5403530e-4)
    p = p * f + float32(1.3333558e-3)
    p = p * f + float32(9.6181291e-3)
    p = p * f + float32(5.5504109e-2)
    p = p * f + float32(2.4022651e-1)
    p = p * f + float32(6.9314718e-1)
    p = p * f + float32(1.0)
    return p * _bits_to_float((n + int32(127)) << int32(23))  # type: ignore[call-arg]
