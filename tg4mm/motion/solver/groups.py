"""Groups of Gaussians that move together: coarse fields, made smooth, and the prior between them.

A group's displacement is linear in space, which costs the prior nothing inside, but it ends where the group does, which
costs much. So every such field is smoothed twice by damped Jacobi steps of the prior's matrix (smoothed aggregation,
Vaněk, Mandel & Brezina 1996): few smooth fields then say what many that jump do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix

from tg4mm.motion.prior.graph import Graph
from tg4mm.motion.prior.stiffness import ROWS, smooth_transposed, smoothed, times_blocks

GROUPS = 256  # at most: their operator is a dense matrix of four times as many rows
_LEAST = 16  # Gaussians of a group
_STEPS = 2  # of smoothing
_DAMPING = 4 / 3  # over the largest eigenvalue: takes the upper half of the spectrum down most evenly
_POWER_STEPS = 15  # for that eigenvalue


@dataclass(frozen=True)
class Groups:
    """Fields of G groups, P: [4G, 3] -> [4N, 3]."""

    graph: Graph
    plain: bsr_matrix  # [4N, 4G] float32: before smoothing, blocks of 4 × 4, one a Gaussian
    smoother: np.ndarray  # [N, 4, 4] float32, symmetric: damped inverse of the prior's own blocks

    @property
    def count(self) -> int:
        return int(self.plain.shape[1]) // ROWS

    @cached_property
    def matrix(self) -> bsr_matrix:
        """P [4N, 4G] float64."""
        n = len(self.smoother)
        blocks = bsr_matrix((self.smoother.astype(np.float64), np.arange(n), np.arange(n + 1)))
        out = self.plain.astype(np.float64)
        for _ in range(_STEPS):
            out = out - blocks @ (self.graph.blocks @ out)
        return out

    @cached_property
    def stiffness(self) -> np.ndarray:
        """[4G, 4G] float64: Pᵀ K P."""
        return np.asarray((self.matrix.T @ (self.graph.blocks @ self.matrix)).toarray())

    @cached_property
    def squares(self) -> np.ndarray:
        """[4G, 4G]: Pᵀ P."""
        return np.asarray((self.matrix.T @ self.matrix).toarray())

    def seen(self, diagonal: np.ndarray) -> np.ndarray:
        """[4G, 4G]: Pᵀ D P of a diagonal [4N]."""
        weighted = self.matrix.copy()
        weighted.data *= np.repeat(diagonal.reshape(-1, ROWS), np.diff(weighted.indptr), axis=0)[..., None]
        return np.asarray((self.matrix.T @ weighted).toarray())

    def field(self, coarse: np.ndarray) -> np.ndarray:
        """P times [4G, 3] float32: [4N, 3] float32."""
        x = self.plain @ coarse
        for _ in range(_STEPS):
            x = smoothed(self.graph.edges, self.smoother, x)
        return np.asarray(x)

    def from_field(self, v: np.ndarray) -> np.ndarray:
        """The transpose of `field`."""
        v = v.copy()
        for _ in range(_STEPS):
            smooth_transposed(self.graph.edges, self.smoother, v)
        return np.asarray(self._gathering @ v)

    @cached_property
    def _gathering(self) -> bsr_matrix:
        return self.plain.T.tobsr()


def groups_of(graph: Graph, means: np.ndarray) -> Groups:
    """The groups of Gaussians at means [N, 3]."""
    own = graph.own_blocks
    # a Gaussian whose neighbours all lie on a line says nothing of some gradients
    own = own + 1e-3 * np.trace(own, axis1=1, axis2=2)[:, None, None] / ROWS * np.eye(ROWS)
    inverse = np.linalg.inv(own)
    smoother = (inverse + inverse.transpose(0, 2, 1)) / 2
    damped = smoother * (_DAMPING / _largest_eigenvalue(graph, smoother.astype(np.float32)))
    plain = _linear_in_groups(means, graph.reach).astype(np.float32)
    return Groups(graph, plain, np.ascontiguousarray(damped, np.float32))


def _largest_eigenvalue(graph: Graph, blocks: np.ndarray) -> float:
    """Of M K, by the power method: of three random fields, the largest growth in the last step."""
    x = np.random.default_rng(0).normal(size=(ROWS * len(blocks), 3)).astype(np.float32)
    for _ in range(_POWER_STEPS):
        x /= np.linalg.norm(x, axis=0)
        product = np.zeros_like(x)
        graph.add_prior(x, 1.0, 0.0, product)
        x = times_blocks(blocks, product)
    return float(np.linalg.norm(x, axis=0).max())


def _linear_in_groups(means: np.ndarray, reach: float) -> bsr_matrix:
    """[4N, 4G]: of each group a displacement and its change along x, y, z, as fields about the group's middle."""
    n, groups = len(means), _split(means)
    group, blocks = np.empty(n, np.int32), np.tile(np.eye(ROWS), (n, 1, 1))
    for g, own in enumerate(groups):
        group[own], blocks[own, 0, 1:] = g, (means[own] - means[own].mean(0)) / reach
    return bsr_matrix((blocks, group, np.arange(n + 1)), shape=(ROWS * n, ROWS * len(groups)))


def _split(means: np.ndarray) -> list[np.ndarray]:
    """At most `GROUPS` groups of `_LEAST` Gaussians or more (or all): halves along the longest side, as a k-d tree."""
    parts = [np.arange(len(means))]
    while 2 * len(parts) <= GROUPS and len(parts[0]) >= 2 * _LEAST:
        halves = []
        for rows in parts:
            axis = int(np.ptp(means[rows], axis=0).argmax())
            order = rows[np.argsort(means[rows, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        parts = halves
    return parts
