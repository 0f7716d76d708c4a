"""The prior on motion: squared second-order total generalised variation on a graph of nearest neighbours.

Every Gaussian has a displacement u_i and a displacement gradient A_i of its own. An edge i, j between x_i and x_j costs
|u_j − u_i − ½ (A_i + A_j)(x_j − x_i)|² and, weighted, |A_j − A_i|² (Bredies, Kunisch & Pock 2010, squared): affine
motion is free, bending is cheap, jumps are dear. It is the same for x, y and z, so a field is [N, 4, 3] and the matrix
acts on its columns: u, then the change of u over the mean spacing along x, y and z.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import get_num_threads
from scipy.sparse import bsr_matrix, coo_matrix, csr_matrix, vstack
from scipy.spatial import cKDTree

from tg4mm.fit.motion.prior.rotation import from_motion, gradient_to_rotation, to_motion
from tg4mm.fit.motion.prior.tgv import BENDING, ROWS, Edges, add_prior

COUNT = 12  # neighbours of a Gaussian in the graph
KNN = 32  # Gaussians, with itself, over which statistics around a Gaussian are averaged


@dataclass(frozen=True)
class Graph:
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
    def edges(self) -> Edges:
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
        own = np.add.reduceat(outer + bending, self.start[:-1])
        first = self.start + np.arange(n + 1)
        at_diagonal = np.zeros(first[-1], bool)
        at_diagonal[first[:-1]] = True
        data, column = np.empty((len(at_diagonal), ROWS, ROWS)), np.empty(len(at_diagonal), np.int32)
        data[at_diagonal], column[at_diagonal] = own, np.arange(n)
        data[~at_diagonal] = -outer * np.array([1.0, -1, -1, -1]) - bending
        column[~at_diagonal] = self.other
        return bsr_matrix((data, column, first), shape=(ROWS * n, ROWS * n))

    @cached_property
    def stiffness(self) -> csr_matrix:
        """`blocks` by rows, float32."""
        return self.blocks.tocsr().sorted_indices().astype(np.float32)

    @property
    def own_blocks(self) -> np.ndarray:
        """[N, 4, 4] on the diagonal of `blocks`."""
        return np.asarray(self.blocks.data[self.start[:-1] + np.arange(self.n_gaussians)])

    def add_prior(self, x: np.ndarray, smoothness: float, ridge: float, out: np.ndarray) -> None:
        """Adds smoothness · K x + ridge · x to `out`, both [4N, 3] float32, contiguous; K is the prior's matrix."""
        add_prior(self.edges, x, smoothness, ridge, out)

    def motion(self, field: np.ndarray) -> np.ndarray:
        """[4N, 3] float32 -> displacement and rotation vector (radians) of every Gaussian, [N, 6] float32."""
        return to_motion(self.gradient_to_rotation, field.reshape(self.n_gaussians, -1))

    def from_motion(self, v_motion: np.ndarray) -> np.ndarray:
        """The transpose of `motion`: [N, 6] -> [4N, 3], float32."""
        return from_motion(self.gradient_to_rotation, v_motion).reshape(-1, 3)


def build_graph(means: np.ndarray, axes: np.ndarray, scales: np.ndarray, count: int = COUNT) -> Graph:
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
    return Graph(
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


def stiffness_root(graph: Graph) -> csr_matrix:
    """S [4E, 4N] float64 with SᵀS = `graph.stiffness` of E edges: displacements, then gradients along x, y, z."""
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


_SCALE = 3.0  # mean squared residuals at which an edge counts half
_LEAST = 0.01  # of its weight is left to an edge: the graph stays connected


def edge_residual(graph: Graph, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[E] float32, scene units squared: the squared residual of every edge that fields a, b [R, 4N, 3] share.

    Their residuals' inner product over fields and x, y, z, for a weight of 1; 0 where it is negative.
    """
    owner = np.repeat(np.arange(graph.n_gaussians), np.diff(graph.start))
    both = np.zeros(len(graph.other))
    for x, y in zip(a, b, strict=True):
        both += np.einsum("ec,ec->e", _residual(graph, owner, x), _residual(graph, owner, y))
    return np.asarray(np.maximum(both, 0), np.float32)


def _residual(graph: Graph, owner: np.ndarray, field: np.ndarray) -> np.ndarray:
    """[E, 3], for a weight of 1."""
    rows = field.reshape(-1, ROWS, 3)
    out = rows[graph.other, 0] - rows[owner, 0]
    for k in range(1, ROWS):
        half_way = graph.edge_rows[:, k] / graph.edge_rows[:, 0]
        out -= half_way[:, None] * (rows[graph.other, k] + rows[owner, k])
    return np.asarray(out)


def reweight_edges(graph: Graph, residual: np.ndarray) -> Graph:
    """The graph with edges reweighted by `edge_residual` [E]; the same graph where that is 0 everywhere."""
    weight = graph.edge_rows[:, 0].astype(np.float64) ** 2
    mean = float((weight * residual).sum() / weight.sum())
    if not mean > 0:
        return graph
    share = np.maximum(1 / (1 + residual / (_SCALE * mean)), _LEAST)
    return replace(graph, edge_rows=(graph.edge_rows * np.sqrt(share)[:, None]).astype(np.float32))
