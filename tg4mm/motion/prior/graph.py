"""Which Gaussians move alike: the prior on the motion, as one sparse matrix.

Every Gaussian has a displacement u_i and a gradient of displacement A_i of its own. Neighbours i, j at x_i, x_j should
agree: u_j − u_i = ½ (A_i + A_j)(x_j − x_i), and their gradients should be alike. That is second-order total
generalised variation on a graph (Bredies, Kunisch & Pock 2010), squared: translation, rotation, shear and stretch cost
nothing, bending little, jumps much. It is the same for x, y and z, so a field is [N, 4, 3] and the matrix works on
its columns: u, then the change of u over one typical distance of neighbours along x, y and z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import get_num_threads
from scipy.sparse import bsr_matrix, csr_matrix
from scipy.spatial import cKDTree

from tg4mm.motion.prior.following import following
from tg4mm.motion.prior.stiffness import BENDING, ROWS, Edges, add_prior
from tg4mm.motion.prior.turning import turned, turned_back

COUNT = 12  # neighbours of a Gaussian
AROUND = 32  # Gaussians of a neighbourhood over which figures are averaged, with its own


@dataclass(frozen=True)
class Graph:
    """Neighbours, the prior's matrix, and what a field says of displacement and rotation.

    An edge's misfit is bond · (σ x_j − x_i), summed over the four rows, with σ = (1, −1, −1, −1): its bond is the root
    of its weight times 1 and half the way to the other end. Every edge is listed at both ends.
    """

    start: np.ndarray  # [N + 1] int64: the edges of Gaussian i are start[i] … start[i + 1] − 1
    other: np.ndarray  # [E] int32: where they lead
    bonds: np.ndarray  # [E, 4] float32
    turns: np.ndarray  # [N, 9, 3] float32: from a gradient as a field holds it to a rotation vector
    reach: float  # typical distance of neighbours, scene units
    around: np.ndarray  # [N, at most AROUND] int32: the Gaussians nearest to each, by distance, with its own

    @property
    def n_gaussians(self) -> int:
        return len(self.turns)

    @property
    def edges(self) -> Edges:
        return self.start, self.other, self.bonds.reshape(-1)

    @cached_property
    def blocks(self) -> bsr_matrix:
        """The prior's matrix [4N, 4N] float64, symmetric, positive semi-definite; mean diagonal of the u rows 1
        unless edges were loosened.

        The first block of a row is the one on the diagonal.
        """
        n, bonds = self.n_gaussians, self.bonds.astype(np.float64)
        outer = bonds[:, :, None] * bonds[:, None, :]
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

    def add_prior(self, x: np.ndarray, stiff: float, ridge: float, out: np.ndarray) -> None:
        """Adds stiff · K x + ridge · x to `out`, both [4N, 3] float32, contiguous; K is the prior's matrix."""
        add_prior(self.edges, x, stiff, ridge, out)

    def motion(self, field: np.ndarray) -> np.ndarray:
        """[4N, 3] float32 -> displacement and rotation vector (radians) of every Gaussian, [N, 6] float32."""
        return turned(self.turns, field.reshape(self.n_gaussians, -1))

    def from_motion(self, v_motion: np.ndarray) -> np.ndarray:
        """The transpose of `motion`: [N, 6] -> [4N, 3], float32."""
        return turned_back(self.turns, v_motion).reshape(-1, 3)


def graph(means: np.ndarray, axes: np.ndarray, scales: np.ndarray, count: int = COUNT) -> Graph:
    """The graph of the `count` nearest neighbours, either way, of N > 1 Gaussians.

    means [N, 3] and scales [N, 3] in scene units, axes [N, 3, 3]: rotation matrices, whose columns the scales go with.
    """
    n = len(means)
    first, second, weight, reach = _edges(*nearest(means, count + 1))
    owner, other = np.concatenate([first, second]), np.concatenate([second, first])
    order = np.lexsort((other, owner))
    owner, other, weight = owner[order], other[order], np.tile(weight, 2)[order]
    weight *= n / weight.sum()
    ways = (means[other] - means[owner]).astype(np.float64) / reach
    bonds = np.sqrt(weight)[:, None] * np.concatenate([np.ones((len(ways), 1)), 0.5 * ways], 1)
    return Graph(
        start=np.searchsorted(owner, np.arange(n + 1)),
        other=other.astype(np.int32),
        bonds=bonds.astype(np.float32),
        turns=following(axes, scales) / np.float32(reach),
        reach=reach,
        around=nearest(means)[1],
    )


def nearest(means: np.ndarray, count: int = AROUND) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices (int32) of the Gaussians nearest to each of `means`, with its own, by distance.

    [N, count] each; of all where they are fewer.
    """
    ranks = np.arange(1, min(count, len(means)) + 1)
    distance, index = cKDTree(means).query(means, k=ranks, workers=get_num_threads())
    return distance, index.astype(np.int32)


def _edges(distance: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Pairs i < j, one of them among the other's nearest [N, 1 + count]; their weights; the typical distance."""
    distance, index = distance[:, 1:], index[:, 1:]
    n, count = index.shape
    reach = np.maximum(distance.mean(1, keepdims=True), 1e-12)
    weight = np.exp(-0.5 * (distance / reach) ** 2).ravel()
    owner, other = np.repeat(np.arange(n), count), index.ravel()
    pairs = np.minimum(owner, other) * np.int64(n) + np.maximum(owner, other)
    unique, of = np.unique(pairs, return_inverse=True)
    return unique // n, unique % n, np.bincount(of, weight), float(np.median(reach))
