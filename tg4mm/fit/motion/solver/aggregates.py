"""The coarse space of the preconditioner: smoothed aggregation on the prior (Vaněk, Mandel & Brezina 1996).

Gaussians are split into aggregates. A tentative coarse field is linear in space inside one aggregate, which costs the
prior nothing there, and 0 elsewhere, which costs much at its border. Damped Jacobi steps of the prior's matrix smooth
it, and the columns of the smoothed prolongation P span the coarse space.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix

from tg4mm.fit.motion.prior.graph import Graph
from tg4mm.fit.motion.prior.tgv import ROWS, smooth_transposed, smoothed, times_blocks

MOST = 256  # aggregates: the coarse operator is dense, with four times as many rows
_LEAST = 16  # Gaussians of an aggregate
_STEPS = 2  # Jacobi steps
_DAMPING = 4 / 3  # over the largest eigenvalue: damps the upper half of the spectrum most evenly
_POWER_STEPS = 15  # for that eigenvalue


@dataclass(frozen=True)
class Aggregates:
    """The prolongation P of G aggregates: coarse fields [4G, 3] -> fields [4N, 3]."""

    graph: Graph
    tentative: bsr_matrix  # [4N, 4G] float32: P before smoothing, one 4 × 4 block a Gaussian
    smoother: np.ndarray  # [N, 4, 4] float32, symmetric: damped inverse of the prior's diagonal blocks

    @property
    def count(self) -> int:
        return int(self.tentative.shape[1]) // ROWS

    @cached_property
    def matrix(self) -> bsr_matrix:
        """P [4N, 4G] float64."""
        n = len(self.smoother)
        blocks = bsr_matrix((self.smoother.astype(np.float64), np.arange(n), np.arange(n + 1)))
        out = self.tentative.astype(np.float64)
        for _ in range(_STEPS):
            out = out - blocks @ (self.graph.blocks @ out)
        return out

    @cached_property
    def stiffness(self) -> np.ndarray:
        """[4G, 4G] float64: Pᵀ K P of the prior's matrix K."""
        return np.asarray((self.matrix.T @ (self.graph.blocks @ self.matrix)).toarray())

    @cached_property
    def gram(self) -> np.ndarray:
        """[4G, 4G]: Pᵀ P."""
        return np.asarray((self.matrix.T @ self.matrix).toarray())

    def galerkin(self, diagonal: np.ndarray) -> np.ndarray:
        """[4G, 4G]: Pᵀ D P of a diagonal matrix D [4N]."""
        weighted = self.matrix.copy()
        weighted.data *= np.repeat(diagonal.reshape(-1, ROWS), np.diff(weighted.indptr), axis=0)[..., None]
        return np.asarray((self.matrix.T @ weighted).toarray())

    def field(self, coarse: np.ndarray) -> np.ndarray:
        """P x: [4G, 3] float32 -> [4N, 3] float32."""
        x = self.tentative @ coarse
        for _ in range(_STEPS):
            x = smoothed(self.graph.edges, self.smoother, x)
        return np.asarray(x)

    def from_field(self, v: np.ndarray) -> np.ndarray:
        """Pᵀ v, the transpose of `field`."""
        v = v.copy()
        for _ in range(_STEPS):
            smooth_transposed(self.graph.edges, self.smoother, v)
        return np.asarray(self._restriction @ v)

    @cached_property
    def _restriction(self) -> bsr_matrix:
        return self.tentative.T.tobsr()


def aggregate(graph: Graph, means: np.ndarray) -> Aggregates:
    """Aggregates of the Gaussians at means [N, 3]."""
    own = graph.own_blocks
    # neighbours that all lie on a line leave some gradients undetermined: the block is singular
    own = own + 1e-3 * np.trace(own, axis1=1, axis2=2)[:, None, None] / ROWS * np.eye(ROWS)
    inverse = np.linalg.inv(own)
    smoother = (inverse + inverse.transpose(0, 2, 1)) / 2
    damped = smoother * (_DAMPING / _largest_eigenvalue(graph, smoother.astype(np.float32)))
    tentative = _tentative(means, graph.mean_spacing).astype(np.float32)
    return Aggregates(graph, tentative, np.ascontiguousarray(damped, np.float32))


def _largest_eigenvalue(graph: Graph, blocks: np.ndarray) -> float:
    """Estimate the largest eigenvalue of M K by power iteration on three random fields."""
    x = np.random.default_rng(0).normal(size=(ROWS * len(blocks), 3)).astype(np.float32)
    for _ in range(_POWER_STEPS):
        x /= np.linalg.norm(x, axis=0)
        product = np.zeros_like(x)
        graph.add_prior(x, 1.0, 0.0, product)
        x = times_blocks(blocks, product)
    return float(np.linalg.norm(x, axis=0).max())


def _tentative(means: np.ndarray, spacing: float) -> bsr_matrix:
    """[4N, 4G]: of each aggregate a displacement and its change along x, y, z, about the aggregate's mean."""
    n, regions = len(means), _split(means)
    column, blocks = np.empty(n, np.int32), np.tile(np.eye(ROWS), (n, 1, 1))
    for g, own in enumerate(regions):
        column[own], blocks[own, 0, 1:] = g, (means[own] - means[own].mean(0)) / spacing
    return bsr_matrix((blocks, column, np.arange(n + 1)), shape=(ROWS * n, ROWS * len(regions)))


def _split(means: np.ndarray) -> list[np.ndarray]:
    """By a k-d tree, halved along the longest side: at most `MOST` regions of `_LEAST` Gaussians or more, or one."""
    regions = [np.arange(len(means))]
    while 2 * len(regions) <= MOST and len(regions[0]) >= 2 * _LEAST:
        halves = []
        for rows in regions:
            axis = int(np.ptp(means[rows], axis=0).argmax())
            order = rows[np.argsort(means[rows, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        regions = halves
    return regions
