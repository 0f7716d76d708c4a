"""Matrix-free products with the prior: squared second-order total generalised variation (Bredies, Kunisch & Pock 2010).

A Gaussian's part of a field is four rows (displacement, and its change along x, y, z) of three columns: one vector
(`simd/field.py`). An edge needs four numbers, so the matrix is never formed. Each Gaussian's rows
are summed by one thread in a fixed order.
"""

# mypy: disable-error-code="call-arg, var-annotated"
# an intrinsic has one argument more than its calls: the typing context

import numpy as np
from numba import float32, int64, prange

from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel
from tg4mm.fit.rasterize.simd.field import broadcast_rows, load_field, store_field, sum_rows, transposed_times
from tg4mm.fit.rasterize.simd.memory import number
from tg4mm.fit.rasterize.simd.vector import broadcast, fma

ROWS = 4  # of a Gaussian's part of a field: displacement, and its gradient along x, y, z
# Weight of differences of gradients against that of edge residuals, chosen on generated scenes
BENDING = 10.0
_WIDTH = 3 * ROWS  # numbers of a Gaussian
_CHUNK = 256  # Gaussians a thread takes at a time
# signs σ of the other end's rows in a residual; weights of the rows in the difference of two ends
_SIGNS = np.array([1, -1, -1, -1, 0, BENDING, BENDING, BENDING], np.float32)


@inlined
def _product(start, other, edge_rows, signs, x, i):
    """Rows of Gaussian i of the prior's matrix times a field."""
    own = load_field(x, int64(i) * _WIDTH)
    sigma, bending = broadcast_rows(signs, int64(0)), broadcast_rows(signs, int64(4))
    total = broadcast(float32(0.0))
    differences = total
    for edge in range(start[i], start[i + 1]):
        there = load_field(x, int64(other[edge]) * _WIDTH)
        row, root = broadcast_rows(edge_rows, int64(edge) * ROWS), number(edge_rows, int64(edge) * ROWS)
        residual = sum_rows(row * fma(there, sigma, -own))
        total = fma(-row, residual, total)
        differences = fma(own - there, root * root, differences)
    return fma(differences, bending, total)


@kernel()
def _prior_of(first, last, edges, signs, x, smoothness, ridge, out):
    start, other, edge_rows = edges
    for i in range(first, last):
        at = int64(i) * _WIDTH
        smooth = fma(_product(start, other, edge_rows, signs, x, i), smoothness, load_field(out, at))
        store_field(out, at, fma(load_field(x, at), ridge, smooth))


@kernel()
def _smoothed(first, last, edges, signs, blocks, x, out):
    start, other, edge_rows = edges
    for i in range(first, last):
        at = int64(i) * _WIDTH
        step = transposed_times(
            blocks, int64(i) * ROWS * ROWS, _product(start, other, edge_rows, signs, x, i)
        )
        store_field(out, at, load_field(x, at) - step)


@kernel()
def _less_product(first, last, edges, signs, x, out):
    start, other, edge_rows = edges
    for i in range(first, last):
        at = int64(i) * _WIDTH
        store_field(out, at, load_field(out, at) - _product(start, other, edge_rows, signs, x, i))


@kernel()
def _blockwise(first, last, blocks, x, out, keep):
    for i in range(first, last):
        at = int64(i) * _WIDTH
        product = transposed_times(blocks, int64(i) * ROWS * ROWS, load_field(x, at))
        store_field(out, at, fma(load_field(out, at), keep, product))


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
