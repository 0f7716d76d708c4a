"""Matrix-free products with the prior: squared second-order total generalised variation (Bredies, Kunisch & Pock 2010).

A Gaussian's part of a field is four rows (displacement, and its change along x, y, z) of three columns: one vector,
four lanes a row, the fourth unused. An edge needs four numbers, so the matrix is never formed. Each Gaussian's rows
are summed by one thread in a fixed order.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import float32, int64, prange, types
from numba.extending import intrinsic

from tg4mm.rasterize.kernels.compiled import inlined, kernel
from tg4mm.rasterize.kernels.memory import data_at, number
from tg4mm.rasterize.kernels.vector import F32, FV, constant_lanes, declare, fma, vector, wide

ROWS = 4  # of a Gaussian's part of a field: displacement, and its gradient along x, y, z
# Weight of differences of gradients against that of edge residuals, chosen on generated scenes
BENDING = 10.0
_WIDTH = 3 * ROWS  # numbers of a Gaussian
_CHUNK = 256  # Gaussians a thread takes at a time
_EACH_ROW = [lane // 4 for lane in range(16)]
# signs σ of the other end's rows in a residual; weights of the rows in the difference of two ends
_SIGNS = np.array([1, -1, -1, -1, 0, BENDING, BENDING, BENDING], np.float32)


def _at(context, builder, sig, args, count, offset=0):
    """Pointer to `count` float32 of the place args[0], `offset` after entry args[1]."""
    place = builder.gep(data_at(context, builder, sig.args[0], args[0]), [args[1]])
    place = builder.gep(place, [ir.Constant(ir.IntType(64), offset)])
    return builder.bitcast(place, ir.VectorType(F32, count).as_pointer())


def _spread(context, builder, sig, args, offset=0):
    four = builder.load(_at(context, builder, sig, args, 4, offset), align=4)
    return builder.shuffle_vector(four, four, constant_lanes(_EACH_ROW))


@intrinsic
def spread(typingctx, array, index):
    """Four float32 of a contiguous array [n], one for each row."""

    def codegen(context, builder, sig, args):
        return _spread(context, builder, sig, args)

    return vector(array, types.int64), codegen


@intrinsic
def load_rows(typingctx, array, index):
    """Four rows of three float32 of a contiguous array [n]."""

    def codegen(context, builder, sig, args):
        low = builder.load(_at(context, builder, sig, args, 8), align=4)
        high = builder.load(_at(context, builder, sig, args, 4, 8), align=4)
        high = builder.shuffle_vector(high, high, constant_lanes([0, 1, 2, 3] * 2))
        return builder.shuffle_vector(
            low, high, constant_lanes([3 * (k // 4) + min(k % 4, 2) for k in range(16)])
        )

    return vector(array, types.int64), codegen


@intrinsic
def store_rows(typingctx, array, index, value):
    """What `load_rows` reads."""

    def codegen(context, builder, sig, args):
        lanes = [k for k in range(16) if k % 4 < 3]
        for offset, some in ((0, lanes[:8]), (8, lanes[8:])):
            part = builder.shuffle_vector(args[2], args[2], constant_lanes(some))
            builder.store(part, _at(context, builder, sig, args, len(some), offset), align=4)
        return context.get_dummy_value()

    return types.none(array, types.int64, vector), codegen


@intrinsic
def sum_of_rows(typingctx, value):
    """The sum of the four rows, in each row."""

    def codegen(context, builder, sig, args):
        total = args[0]
        for shift in (8, 4):
            rotated = builder.shuffle_vector(
                total, total, constant_lanes([(k + shift) % 16 for k in range(16)])
            )
            total = builder.fadd(total, rotated)
        return total

    return vector(vector), codegen


@intrinsic
def transposed_times(typingctx, array, index, value):
    """Mᵀ times four rows, of the 4 × 4 block M that begins at `index` of a contiguous float32 array [n]."""

    def codegen(context, builder, sig, args):
        total, multiply_add = ir.Constant(FV, None), declare(builder, "llvm.fmuladd.v16f32", FV, [FV] * 3)
        for row in range(ROWS):
            column = _spread(context, builder, sig, args, ROWS * row)
            lanes = constant_lanes([ROWS * row + k % 4 for k in range(16)])
            there = builder.shuffle_vector(args[2], args[2], lanes)
            total = builder.call(multiply_add, [column, there, total])
        return total

    return vector(array, types.int64, vector), codegen


@inlined
def _product(start, other, edge_rows, signs, x, i):
    """Rows of Gaussian i of the prior's matrix times a field."""
    own, sigma, bending = load_rows(x, int64(i) * _WIDTH), spread(signs, int64(0)), spread(signs, int64(4))
    total = wide(float32(0.0))
    differences = total
    for edge in range(start[i], start[i + 1]):
        there = load_rows(x, int64(other[edge]) * _WIDTH)
        row, root = spread(edge_rows, int64(edge) * ROWS), number(edge_rows, int64(edge) * ROWS)
        residual = sum_of_rows(row * fma(there, sigma, -own))
        total = fma(-row, residual, total)
        differences = fma(own - there, root * root, differences)
    return fma(differences, bending, total)


@kernel()
def _prior_of(first, last, edges, signs, x, smoothness, ridge, out):
    start, other, edge_rows = edges
    for i in range(first, last):
        at = int64(i) * _WIDTH
        smooth = fma(_product(start, other, edge_rows, signs, x, i), smoothness, load_rows(out, at))
        store_rows(out, at, fma(load_rows(x, at), ridge, smooth))


@kernel()
def _smoothed(first, last, edges, signs, blocks, x, out):
    start, other, edge_rows = edges
    for i in range(first, last):
        at = int64(i) * _WIDTH
        step = transposed_times(
            blocks, int64(i) * ROWS * ROWS, _product(start, other, edge_rows, signs, x, i)
        )
        store_rows(out, at, load_rows(x, at) - step)


@kernel()
def _less_product(first, last, edges, signs, x, out):
    start, other, edge_rows = edges
    for i in range(first, last):
        at = int64(i) * _WIDTH
        store_rows(out, at, load_rows(out, at) - _product(start, other, edge_rows, signs, x, i))


@kernel()
def _blockwise(first, last, blocks, x, out, keep):
    for i in range(first, last):
        at = int64(i) * _WIDTH
        product = transposed_times(blocks, int64(i) * ROWS * ROWS, load_rows(x, at))
        store_rows(out, at, fma(load_rows(out, at), keep, product))


@kernel(parallel=True)
def _add_prior(n, edges, signs, x, smoothness, ridge, out):
    for chunk in prange((n + _CHUNK - 1) // _CHUNK):
        _prior_of(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK), edges, signs, x, smoothness, ridge, out)


@kernel(parallel=True)
def _smooth(n, edges, signs, blocks, x, out):
    for chunk in prange((n + _CHUNK - 1) // _CHUNK):
        _smoothed(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK), edges, signs, blocks, x, out)


@kernel(parallel=True)
def _subtract_product(n, edges, signs, x, out):
    for chunk in prange((n + _CHUNK - 1) // _CHUNK):
        _less_product(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK), edges, signs, x, out)


@kernel(parallel=True)
def _multiply_blocks(n, blocks, x, out, keep):
    for chunk in prange((n + _CHUNK - 1) // _CHUNK):
        _blockwise(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK), blocks, x, out, keep)


# As `Graph.edges` gives them: start [N + 1] int64, other end [E] int32, edge rows [4 E] float32. Fields [4N, 3] and
# blocks [N, 4, 4] are float32 and contiguous.
Edges = tuple[np.ndarray, np.ndarray, np.ndarray]


def add_prior(edges: Edges, x: np.ndarray, smoothness: float, ridge: float, out: np.ndarray) -> None:
    """Adds smoothness · K x + ridge · x to `out`."""
    n = len(x) // ROWS
    _add_prior(n, edges, _SIGNS, x.reshape(-1), np.float32(smoothness), np.float32(ridge), out.reshape(-1))


def smoothed(edges: Edges, blocks: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(I − M K) x, with M block diagonal of symmetric blocks: one Jacobi step."""
    out = np.empty_like(x)
    _smooth(len(blocks), edges, _SIGNS, blocks.reshape(-1), x.reshape(-1), out.reshape(-1))
    return out


def smooth_transposed(edges: Edges, blocks: np.ndarray, v: np.ndarray) -> None:
    """(I − K M) v in place of v: the transpose of `smoothed`."""
    product = times_blocks(blocks, v)
    _subtract_product(len(blocks), edges, _SIGNS, product.reshape(-1), v.reshape(-1))


def times_blocks(blocks: np.ndarray, x: np.ndarray, onto: np.ndarray | None = None) -> np.ndarray:
    """Mᵀ x of blocks M; with `onto`, added to it in place."""
    out, keep = (np.zeros_like(x), 0.0) if onto is None else (onto, 1.0)
    _multiply_blocks(len(blocks), blocks.reshape(-1), x.reshape(-1), out.reshape(-1), np.float32(keep))
    return out
