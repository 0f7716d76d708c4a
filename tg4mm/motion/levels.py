"""Unknowns of like influence, fine and coarse, so that conjugate gradients need a dozen iterations.

What is seen well settles in a few iterations; what hardly costs anything, such as a whole part that sways, takes
hundreds, since a Gaussian hears of it only from its neighbours. So there are two levels of unknowns that add up: for
every Gaussian its own four rows, scaled by the inverse root of its block on the operator's diagonal, and for every one
of some hundred groups of Gaussians a displacement that is linear in space, scaled by the inverse root of the operator
between groups. Conjugate gradients on these unknowns are those with an additive two-level preconditioner (Schwarz). It
changes neither the problem nor what it converges to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_matrix, diags, kron

from tg4mm.motion.graph import ROWS, Graph
from tg4mm.motion.linear import DOF, RestView

GROUPS = 512  # at most: their operator is a dense matrix of four times as many rows
_LEAST = 16  # Gaussians of a group
PROBES = 8  # random pictures for the images' part of the diagonal: 50 % spread, which a preconditioner bears


@dataclass(frozen=True)
class Levels:
    """x = B θ: θ [P, 3] holds 4 N rows of single Gaussians, then 4 G of groups."""

    blocks: np.ndarray  # [N, 4, 4] float32
    groups: csr_matrix  # [4N, 4G] float32: from linear displacements of groups to fields
    turn: np.ndarray  # [4G, 4G] float32

    @property
    def n_parameters(self) -> int:
        return ROWS * len(self.blocks) + len(self.turn)

    def field(self, theta: np.ndarray) -> np.ndarray:
        """θ [P, 3] -> x [4N, 3] float32."""
        fine = ROWS * len(self.blocks)
        x = (self.blocks @ theta[:fine].reshape(-1, ROWS, 3)).reshape(-1, 3)
        return np.asarray(x + self.groups @ (self.turn @ theta[fine:]))

    def from_field(self, v: np.ndarray) -> np.ndarray:
        """The transpose of `field`: [4N, 3] -> [P, 3]."""
        fine = (self.blocks.transpose(0, 2, 1) @ v.reshape(-1, ROWS, 3)).reshape(-1, 3)
        return np.concatenate([fine, self.turn.T @ (self.groups.T @ v)])


def information(
    views: list[RestView],
    n: int,
    rng: np.random.Generator,
    weights: np.ndarray | None = None,
    probes: int = PROBES,
) -> np.ndarray:
    """[N, 2]: what the images say of displacement and of rotation, the diagonal of JᵀWJ, mean over x, y, z.

    For signs z drawn at random, the mean of (Jᵀ z)² is that diagonal, whatever lies beside it.
    """
    v_motions = np.zeros((probes, n, DOF), np.float32)
    for k, view in enumerate(views):
        shape = (probes, *view.transmittance.shape, 3)
        shown = (rng.integers(0, 2, shape, np.int8) * 2 - 1).astype(np.float32)
        view.pull_all(shown if weights is None else shown * np.sqrt(weights[k, ..., None]), v_motions)
    return (v_motions.astype(np.float64) ** 2).mean(0).reshape(n, 2, 3).mean(2)


def levels(graph: Graph, known: np.ndarray, means: np.ndarray, prior: float, ridge: float) -> Levels:
    """The levels of a problem: `known` [N, 2] of `information`, `prior` h λ, `ridge` h μ, means [N, 3]."""
    diagonal = np.empty((len(means), ROWS))
    diagonal[:, 0] = known[:, 0]
    diagonal[:, 1:] = known[:, 1:] / (4 * graph.reach**2)  # a rotation is half the curl
    operator = prior * graph.stiffness.astype(np.float64) + diags(diagonal.ravel() + ridge)
    blocks = np.linalg.cholesky(_blocks(operator))
    inverse = np.linalg.inv(blocks).transpose(0, 2, 1)
    between = _linear_in_groups(means, graph.reach)
    lower = cholesky((between.T @ operator @ between).toarray(), lower=True)
    turn = solve_triangular(lower, np.eye(len(lower)), lower=True).T
    return Levels(inverse.astype(np.float32), between.astype(np.float32), np.asarray(turn, np.float32))


def _blocks(operator: csr_matrix) -> np.ndarray:
    """[N, 4, 4] on the diagonal of [4N, 4N]."""
    n = operator.shape[0] // ROWS
    pattern = kron(diags(np.ones(n)), np.ones((ROWS, ROWS)))
    entries = operator.multiply(pattern).tocoo()
    out = np.zeros((n, ROWS, ROWS))
    out[entries.row // ROWS, entries.row % ROWS, entries.col % ROWS] = entries.data
    return out


def _linear_in_groups(means: np.ndarray, reach: float) -> csr_matrix:
    """[4N, 4G]: of each group a displacement and its change along x, y, z, as fields about the group's middle."""
    n, groups = len(means), _split(means)
    group, arms = np.empty(n, np.int64), np.empty((n, 3))
    for g, own in enumerate(groups):
        group[own], arms[own] = g, (means[own] - means[own].mean(0)) / reach
    first = ROWS * np.arange(n)
    rows: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    values: list[np.ndarray] = []
    for c in range(ROWS):
        rows.append(first)  # displacement
        columns.append(ROWS * group + c)
        values.append(np.ones(n) if c == 0 else arms[:, c - 1])
        if c:
            rows.append(first + c)  # its gradient
            columns.append(ROWS * group + c)
            values.append(np.ones(n))
    where = (np.concatenate(rows), np.concatenate(columns))
    return csr_matrix((np.concatenate(values), where), shape=(ROWS * n, ROWS * len(groups)))


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
