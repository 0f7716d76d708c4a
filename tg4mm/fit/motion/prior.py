"""The prior on motion: squared second-order total generalised variation on a graph of nearest neighbours.

Every Gaussian has a displacement u_i and a displacement gradient A_i. An edge i, j between x_i and x_j costs
|u_j − u_i − ½ (A_i + A_j)(x_j − x_i)|² and, weighted, |A_j − A_i|² (Bredies, Kunisch & Pock 2010, squared): affine
motion is free, bending is cheap, jumps are dear. It is the same for x, y and z, so a field is [N, 4, 3] and the matrix
acts on its columns: u, then the change of u over the mean spacing along x, y and z. In the kernels a Gaussian's part of
a field is one vector (`simd/lanes.py`); an edge needs four numbers, so the matrix is never formed.

A Gaussian's rotation follows from the gradient G: a displacement changes a covariance Σ by GΣ + ΣGᵀ to first order, and
the rotation is the one that changes Σ most nearly so, in least squares. For a ball that is half the curl; a flake or a
needle stays in the surface or line that it lies in, also where that shears.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import float32, get_num_threads, int64
from scipy.sparse import bsr_matrix, coo_matrix, csr_matrix, vstack
from scipy.spatial import cKDTree

from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel, shared
from tg4mm.fit.rasterize.simd.lanes import broadcast_rows, load_field, store_field, sum_rows, transposed_times
from tg4mm.fit.rasterize.simd.memory import number
from tg4mm.fit.rasterize.simd.vector import broadcast, fma

# Squared difference of two variances, relative to their squared sum, below which the rotation tends to half the curl
_ISOTROPIC = 0.02
ROWS = 4  # of a Gaussian's part of a field: displacement, and its gradient along x, y, z
# Weight of differences of gradients against that of edge residuals, chosen on generated scenes
BENDING = 10.0
_WIDTH = 3 * ROWS  # numbers of a Gaussian
_CHUNK = 256  # Gaussians a thread takes at a time
# signs σ of the other end's rows in a residual; weights of the rows in the difference of two ends
_SIGNS = np.array([1, -1, -1, -1, 0, BENDING, BENDING, BENDING], np.float32)
COUNT = 12  # neighbours of a Gaussian in the graph
KNN = 32  # Gaussians, with itself, over which statistics around a Gaussian are averaged
_SCALE = 3.0  # mean squared residuals at which an edge counts half
_LEAST = 0.01  # of its weight is left to an edge: the graph stays connected


def gradient_to_rotation(axes: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return [N, 9, 3] float32: from gradients of displacement to rotation vectors in radians, world axes.

    axes [N, 3, 3]: rotation matrices, whose columns the scales [N, 3] go with. Rows are gradients ∂u_of/∂x_along in the
    order (along, of). Within two principal axes a, b with variances s_a, s_b, a rotation W and a gradient G change the
    covariance by W_ab (s_b − s_a) and by G_ab s_b + G_ba s_a. Where s_a = s_b that leaves W undetermined, and
    ½ (G_ab − G_ba) is taken.
    """
    variances = scales.astype(np.float64) ** 2
    out = np.zeros((len(axes), 3, 3, 3))  # along, of, about
    for k, a, b in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):  # ω_k = W_ab
        s_a, s_b = variances[:, a], variances[:, b]
        anisotropy, ridge = (s_b - s_a) ** 2, np.maximum(_ISOTROPIC * (s_a + s_b) ** 2, 1e-60)
        of_ab = ((s_b - s_a) * s_b + ridge / 2) / (anisotropy + ridge)
        of_ba = ((s_b - s_a) * s_a - ridge / 2) / (anisotropy + ridge)
        e_a, e_b, about = axes[:, :, a], axes[:, :, b], axes[:, :, k]
        out += np.einsum("n,nj,ni,nk->njik", of_ab, e_b, e_a, about)  # G_ab = Σ e_a[i] e_b[j] ∂u_i/∂x_j
        out += np.einsum("n,nj,ni,nk->njik", of_ba, e_a, e_b, about)
    return out.reshape(-1, 9, 3).astype(np.float32)


@kernel
def _to_motion(rotations, field, motion):
    for i in range(len(rotations)):
        for d in range(3):
            motion[i, d] = field[i, d]
            total = rotations[i, 0, d] * field[i, 3]
            for k in range(1, 9):
                total += rotations[i, k, d] * field[i, 3 + k]
            motion[i, 3 + d] = total


@kernel
def _from_motion(rotations, v_motion, v_field):
    for i in range(len(rotations)):
        x, y, z = v_motion[i, 3], v_motion[i, 4], v_motion[i, 5]
        for d in range(3):
            v_field[i, d] = v_motion[i, d]
        for k in range(9):
            v_field[i, 3 + k] = rotations[i, k, 0] * x + rotations[i, k, 1] * y + rotations[i, k, 2] * z


@inlined
def _product(start, other, edge_rows, signs, x, i):
    """Rows of Gaussian i of the prior's matrix times a field."""
    here = load_field(x, int64(i) * _WIDTH)
    sigma, bending = broadcast_rows(signs, int64(0)), broadcast_rows(signs, int64(4))
    total = broadcast(float32(0.0))
    differences = total
    for edge in range(start[i], start[i + 1]):
        there = load_field(x, int64(other[edge]) * _WIDTH)
        row, root = broadcast_rows(edge_rows, int64(edge) * ROWS), number(edge_rows, int64(edge) * ROWS)
        residual = sum_rows(row * fma(there, sigma, -here))
        total = fma(-row, residual, total)
        differences = fma(here - there, root * root, differences)
    return fma(differences, bending, total)


@shared
def _add_prior(worker, workers, n, edges, signs, x, smoothness, ridge, out):
    start, other, edge_rows = edges
    for chunk in range(worker, (n + _CHUNK - 1) // _CHUNK, workers):
        for i in range(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)):
            at = int64(i) * _WIDTH
            smooth = fma(_product(start, other, edge_rows, signs, x, i), smoothness, load_field(out, at))
            store_field(out, at, fma(load_field(x, at), ridge, smooth))


@shared
def _smooth(worker, workers, n, edges, signs, blocks, x, out):
    start, other, edge_rows = edges
    for chunk in range(worker, (n + _CHUNK - 1) // _CHUNK, workers):
        for i in range(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)):
            at = int64(i) * _WIDTH
            product = _product(start, other, edge_rows, signs, x, i)
            store_field(
                out, at, load_field(x, at) - transposed_times(blocks, int64(i) * ROWS * ROWS, product)
            )


@shared
def _multiply_blocks(worker, workers, n, blocks, x, out, keep):
    for chunk in range(worker, (n + _CHUNK - 1) // _CHUNK, workers):
        for i in range(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)):
            at = int64(i) * _WIDTH
            product = transposed_times(blocks, int64(i) * ROWS * ROWS, load_field(x, at))
            store_field(out, at, fma(load_field(out, at), keep, product))


def times_blocks(blocks: np.ndarray, x: np.ndarray, onto: np.ndarray | None = None) -> np.ndarray:
    """Return Mᵀ x of blocks M; with `onto`, add it there in place."""
    out, keep = (np.zeros_like(x), 0.0) if onto is None else (onto, 1.0)
    _multiply_blocks(len(blocks), blocks.reshape(-1), x.reshape(-1), out.reshape(-1), np.float32(keep))
    return out


@dataclass(frozen=True)
class NeighbourGraph:
    """Edges and the prior's matrix, and the map from fields to displacement and rotation.

    The residual of edge (i, j) is row · (σ x_j − x_i), summed over the four rows of a field, with σ = (1, −1, −1, −1);
    its `edge_rows` are the root of its weight times (1, half the way from i to j). Every edge is listed at both ends.
    """

    start: np.ndarray  # [N + 1] int64: the edges of Gaussian i are start[i] … start[i + 1] − 1
    other: np.ndarray  # [E] int32: the other end of an edge
    edge_rows: np.ndarray  # [E, 4] float32
    gradient_to_rotation: np.ndarray  # [N, 9, 3] float32: a field's gradient to a rotation vector
    mean_spacing: float  # median over Gaussians of the mean distance to neighbours, scene units
    knn: np.ndarray  # [N, at most KNN] int32: the Gaussians nearest to each, by distance, itself first

    @property
    def n_gaussians(self) -> int:
        return len(self.gradient_to_rotation)

    @property
    def _edges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.start, self.other, self.edge_rows.reshape(-1)

    @cached_property
    def blocks(self) -> bsr_matrix:
        """Return the prior's matrix [4N, 4N] float64, symmetric and positive semi-definite.

        The mean diagonal of the u rows is 1 unless edges were reweighted. The first block of a row is the diagonal
        one.
        """
        n, rows = self.n_gaussians, self.edge_rows.astype(np.float64)
        outer = rows[:, :, None] * rows[:, None, :]
        bending = BENDING * outer[:, :1, :1] * np.diag([0.0, 1, 1, 1])
        diagonal = np.add.reduceat(outer + bending, self.start[:-1])
        first = self.start + np.arange(n + 1)
        at_diagonal = np.zeros(first[-1], bool)
        at_diagonal[first[:-1]] = True
        data, column = np.empty((len(at_diagonal), ROWS, ROWS)), np.empty(len(at_diagonal), np.int32)
        data[at_diagonal], column[at_diagonal] = diagonal, np.arange(n)
        data[~at_diagonal] = -outer * np.array([1.0, -1, -1, -1]) - bending
        column[~at_diagonal] = self.other
        return bsr_matrix((data, column, first), shape=(ROWS * n, ROWS * n))

    @cached_property
    def stiffness(self) -> csr_matrix:
        """`blocks` by rows, float32."""
        return self.blocks.tocsr().sorted_indices().astype(np.float32)

    @property
    def own_blocks(self) -> np.ndarray:
        """Return [N, 4, 4] on the diagonal of `blocks`."""
        return np.asarray(self.blocks.data[self.start[:-1] + np.arange(self.n_gaussians)])

    def add_prior(self, x: np.ndarray, smoothness: float, ridge: float, out: np.ndarray) -> None:
        """Add smoothness · K x + ridge · x to `out`, both [4N, 3] float32, contiguous; K is the prior's matrix."""
        weights = np.float32(smoothness), np.float32(ridge)
        _add_prior(self.n_gaussians, self._edges, _SIGNS, x.reshape(-1), *weights, out.reshape(-1))

    def smoothed(self, blocks: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return (I − M K) x, with M block diagonal of symmetric blocks: one Jacobi step."""
        out = np.empty_like(x)
        _smooth(len(blocks), self._edges, _SIGNS, blocks.reshape(-1), x.reshape(-1), out.reshape(-1))
        return out

    def smooth_transposed(self, blocks: np.ndarray, v: np.ndarray) -> None:
        """Replace v by (I − K M) v, the transpose of `smoothed`."""
        self.add_prior(times_blocks(blocks, v), -1.0, 0.0, v)

    def motion(self, field: np.ndarray) -> np.ndarray:
        """Return [4N, 3] float32 -> displacement and rotation vector (radians) of every Gaussian, [N, 6] float32."""
        motion = np.empty((self.n_gaussians, 6), np.float32)
        _to_motion(self.gradient_to_rotation, field.reshape(self.n_gaussians, -1), motion)
        return motion

    def from_motion(self, v_motion: np.ndarray) -> np.ndarray:
        """The transpose of `motion`: [N, 6] -> [4N, 3], float32."""
        v_field = np.empty((self.n_gaussians, _WIDTH), np.float32)
        _from_motion(self.gradient_to_rotation, v_motion, v_field)
        return v_field.reshape(-1, 3)


def build_graph(
    means: np.ndarray, axes: np.ndarray, scales: np.ndarray, count: int = COUNT
) -> NeighbourGraph:
    """The symmetrised graph of the `count` nearest neighbours of N > 1 Gaussians.

    means [N, 3] and scales [N, 3] in scene units, axes [N, 3, 3]: rotation matrices, whose columns the scales go with.
    """
    n = len(means)
    first, second, weight, spacing = _edges(*nearest(means, count + 1))
    owner, other = np.concatenate([first, second]), np.concatenate([second, first])
    order = np.lexsort((other, owner))
    owner, other, weight = owner[order], other[order], np.tile(weight, 2)[order]
    weight *= n / weight.sum()
    ways = (means[other] - means[owner]).astype(np.float64) / spacing
    edge_rows = np.sqrt(weight)[:, None] * np.concatenate([np.ones((len(ways), 1)), 0.5 * ways], 1)
    return NeighbourGraph(
        start=np.searchsorted(owner, np.arange(n + 1)),
        other=other.astype(np.int32),
        edge_rows=edge_rows.astype(np.float32),
        gradient_to_rotation=gradient_to_rotation(axes, scales) / np.float32(spacing),
        mean_spacing=spacing,
        knn=nearest(means)[1],
    )


def nearest(means: np.ndarray, count: int = KNN) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices (int32) of the Gaussians nearest to each of `means`, itself first.

    [N, count] each; fewer columns where there are fewer Gaussians.
    """
    ranks = np.arange(1, min(count, len(means)) + 1)
    distance, index = cKDTree(means).query(means, k=ranks, workers=get_num_threads())
    return distance, index.astype(np.int32)


def _edges(distance: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Pairs i < j, one of them among the other's nearest [N, 1 + count]; their weights; the mean spacing."""
    distance, index = distance[:, 1:], index[:, 1:]
    n, count = index.shape
    spacing = np.maximum(distance.mean(1, keepdims=True), 1e-12)
    weight = np.exp(-0.5 * (distance / spacing) ** 2).ravel()
    owner, other = np.repeat(np.arange(n), count), index.ravel()
    pairs = np.minimum(owner, other) * np.int64(n) + np.maximum(owner, other)
    unique, of = np.unique(pairs, return_inverse=True)
    return unique // n, unique % n, np.bincount(of, weight), float(np.median(spacing))


def stiffness_root(graph: NeighbourGraph) -> csr_matrix:
    """Return S [4E, 4N] float64 with SᵀS = `graph.stiffness` of E edges: displacements, then gradients."""
    n = graph.n_gaussians
    owner = np.repeat(np.arange(n), np.diff(graph.start))
    once = owner < graph.other  # every edge is listed at both ends
    first, second = owner[once], graph.other[once].astype(np.int64)
    rows = graph.edge_rows[once].astype(np.float64)
    root, half = rows[:, 0], rows[:, 1:]
    edges, shape = np.arange(len(first)), (len(first), ROWS * n)
    values = np.concatenate([root, *-half.T, -root, *-half.T])
    columns = np.concatenate([ROWS * end + c for end in (second, first) for c in range(ROWS)])
    parts = [coo_matrix((values, (np.tile(edges, 2 * ROWS), columns)), shape=shape)]
    bending = np.sqrt(BENDING) * np.concatenate([root, -root])
    for c in range(1, ROWS):
        ends = np.concatenate([ROWS * second + c, ROWS * first + c])
        parts.append(coo_matrix((bending, (np.tile(edges, 2), ends)), shape=shape))
    return csr_matrix(vstack(parts))


def edge_residual(graph: NeighbourGraph, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return [E] float32, scene units squared: the squared residual of every edge that fields a, b [R, 4N, 3] share.

    Their residuals' inner product over fields and x, y, z, for a weight of 1; 0 where it is negative.
    """
    owner = np.repeat(np.arange(graph.n_gaussians), np.diff(graph.start))
    both = np.zeros(len(graph.other))
    for x, y in zip(a, b, strict=True):
        both += np.einsum("ec,ec->e", _residual(graph, owner, x), _residual(graph, owner, y))
    return np.asarray(np.maximum(both, 0), np.float32)


def _residual(graph: NeighbourGraph, owner: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Return [E, 3], for a weight of 1."""
    rows = field.reshape(-1, ROWS, 3)
    out = rows[graph.other, 0] - rows[owner, 0]
    for k in range(1, ROWS):
        half_way = graph.edge_rows[:, k] / graph.edge_rows[:, 0]
        out -= half_way[:, None] * (rows[graph.other, k] + rows[owner, k])
    return np.asarray(out)


def reweight_edges(graph: NeighbourGraph, residual: np.ndarray) -> NeighbourGraph:
    """The graph with edges reweighted by `edge_residual` [E]; the same graph where that is 0 everywhere."""
    weight = graph.edge_rows[:, 0].astype(np.float64) ** 2
    mean = float((weight * residual).sum() / weight.sum())
    if not mean > 0:
        return graph
    share = np.maximum(1 / (1 + residual / (_SCALE * mean)), _LEAST)
    return replace(graph, edge_rows=(graph.edge_rows * np.sqrt(share)[:, None]).astype(np.float32))
