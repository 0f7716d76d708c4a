"""Which Gaussians move alike: the prior on the motion, as one sparse matrix.

Every Gaussian has a displacement u_i and a gradient of displacement A_i of its own. Neighbours i, j at x_i, x_j should
agree: u_j − u_i = ½ (A_i + A_j)(x_j − x_i), and their gradients should be alike. That is second-order total
generalised variation on a graph (Bredies, Kunisch & Pock 2010), squared: translation, rotation, shear and stretch cost
nothing, bending little, jumps much. It is the same for x, y and z, so a field is [N, 4, 3] and the matrix works on
its columns: u, then the change of u over one typical distance of neighbours along x, y and z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags, kron
from scipy.spatial import cKDTree

from tg4mm.motion.following import following

COUNT = 12  # neighbours of a Gaussian
ROWS = 4  # of a Gaussian's part of a field: displacement, and its gradient along x, y, z
# Weight of gradients that differ, beside that of displacements that do not fit: docs/decisions.md
BENDING = 10.0


@dataclass(frozen=True)
class Graph:
    """Neighbours, the prior's matrix, and what a field says of displacement and rotation."""

    # [4N, 4N] float32, symmetric, positive semi-definite; the mean diagonal of the u rows is 1
    stiffness: csr_matrix
    turns: np.ndarray  # [N, 9, 3] float32: from a gradient as a field holds it to a rotation vector
    reach: float  # typical distance of neighbours, scene units

    @property
    def n_gaussians(self) -> int:
        return len(self.turns)

    def motion(self, field: np.ndarray) -> np.ndarray:
        """[4N, 3] -> displacement and rotation vector (radians) of every Gaussian, [N, 6] float32."""
        f = field.reshape(-1, ROWS, 3)
        turned = (f[:, 1:].reshape(-1, 1, 9) @ self.turns)[:, 0]
        return np.concatenate([f[:, 0], turned], 1).astype(np.float32, copy=False)

    def from_motion(self, v_motion: np.ndarray) -> np.ndarray:
        """The transpose of `motion`: [N, 6] -> [4N, 3]."""
        out = np.empty((len(v_motion), ROWS, 3), np.float32)
        out[:, 0] = v_motion[:, :3]
        out[:, 1:] = (self.turns @ v_motion[:, 3:, None]).reshape(-1, 3, 3)
        return out.reshape(-1, 3)


def graph(means: np.ndarray, axes: np.ndarray, scales: np.ndarray, count: int = COUNT) -> Graph:
    """The graph of the `count` nearest neighbours, either way, of N > 1 Gaussians.

    means [N, 3] and scales [N, 3] in scene units, axes [N, 3, 3]: rotation matrices, whose columns the scales go with.
    """
    n = len(means)
    first, second, weight, reach = _edges(means.astype(np.float64), min(count, n - 1))
    arms = (means[second] - means[first]).astype(np.float64) / reach
    edges, ones = np.arange(len(first)), np.ones(len(first))
    # one row for each edge: u_j − u_i − ½ (A_i + A_j) d
    half = -0.5 * arms
    rows = np.tile(edges, 2 * ROWS)
    columns = np.concatenate([ROWS * end + c for end in (second, first) for c in range(ROWS)])
    values = np.concatenate([ones, *half.T, -ones, *half.T])
    misfits = coo_matrix((values, (rows, columns)), shape=(len(edges), ROWS * n)).tocsr()
    ends = (np.concatenate([ones, -ones]), (np.tile(edges, 2), np.concatenate([second, first])))
    differences = coo_matrix(ends, shape=(len(edges), n)).tocsr()
    laplacian = differences.T @ diags(weight) @ differences
    total = misfits.T @ diags(weight) @ misfits + BENDING * kron(laplacian, np.diag([0.0, 1, 1, 1]))
    stiffness = csr_matrix(total / laplacian.diagonal().mean()).astype(np.float32)
    return Graph(stiffness, following(axes, scales) / np.float32(reach), reach)


def _edges(means: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Pairs i < j, one of them among the other's nearest; their weights; the typical distance."""
    distance, index = cKDTree(means).query(means, k=count + 1)
    distance, index = distance[:, 1:], index[:, 1:]
    reach = np.maximum(distance.mean(1, keepdims=True), 1e-12)
    weight = np.exp(-0.5 * (distance / reach) ** 2).ravel()
    owner, other = np.repeat(np.arange(len(means)), count), index.ravel()
    pairs = np.minimum(owner, other) * np.int64(len(means)) + np.maximum(owner, other)
    unique, of = np.unique(pairs, return_inverse=True)
    return unique // len(means), unique % len(means), np.bincount(of, weight), float(np.median(reach))
