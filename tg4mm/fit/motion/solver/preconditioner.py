"""An additive two-level Schwarz preconditioner, so that conjugate gradients need few iterations.

What the images determine well converges in a few iterations; a whole part that sways costs the prior hardly anything
and takes hundreds, since each iteration couples a Gaussian to its neighbours only. The fine level is block Jacobi, one
4 × 4 block a Gaussian; the coarse level the Galerkin operator on aggregates. Both enter by a root of their inverse as a
change of variables x = B θ, which needs no change to conjugate gradients.

The coarse space is smoothed aggregation on the prior (Vaněk, Mandel & Brezina 1996). Gaussians are split into
aggregates. A tentative coarse field is linear in space inside one aggregate, which costs the prior nothing there, and 0
elsewhere, which costs much at its border. Damped Jacobi steps of the prior's matrix smooth it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import bsr_matrix

from tg4mm.core.memory import Buffers
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian
from tg4mm.fit.motion.prior import ROWS, NeighbourGraph, times_blocks

MOST = 256  # aggregates: the coarse operator is dense, with four times as many rows
_LEAST = 16  # Gaussians of an aggregate
_STEPS = 2  # Jacobi steps
_DAMPING = 4 / 3  # over the largest eigenvalue: damps the upper half of the spectrum most evenly
_POWER_STEPS = 15  # for that eigenvalue
PROBES = 8  # random pictures to estimate the diagonal of JᵀWJ: 50 % deviation, enough for a preconditioner
# Factor on the fine level's diagonal of JᵀWJ. Patches of Gaussians smaller than an aggregate share pixels but have no
# level of their own; the diagonal alone underestimates what the images determine of them. Chosen by iteration counts.
_PATCH = 32.0


@dataclass(frozen=True)
class Aggregates:
    """The prolongation P of G aggregates: coarse fields [4G, 3] -> fields [4N, 3]."""

    graph: NeighbourGraph
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
        """Return [4G, 4G] float64: Pᵀ K P of the prior's matrix K."""
        return np.asarray((self.matrix.T @ (self.graph.blocks @ self.matrix)).toarray())

    @cached_property
    def gram(self) -> np.ndarray:
        """Return [4G, 4G]: Pᵀ P."""
        return np.asarray((self.matrix.T @ self.matrix).toarray())

    def galerkin(self, diagonal: np.ndarray) -> np.ndarray:
        """Return [4G, 4G]: Pᵀ D P of a diagonal matrix D [4N]."""
        weighted = self.matrix.copy()
        weighted.data *= np.repeat(diagonal.reshape(-1, ROWS), np.diff(weighted.indptr), axis=0)[..., None]
        return np.asarray((self.matrix.T @ weighted).toarray())

    def field(self, coarse: np.ndarray) -> np.ndarray:
        """P x: [4G, 3] float32 -> [4N, 3] float32."""
        x = self.tentative @ coarse
        for _ in range(_STEPS):
            x = self.graph.smoothed(self.smoother, x)
        return np.asarray(x)

    def from_field(self, v: np.ndarray) -> np.ndarray:
        """Pᵀ v, the transpose of `field`."""
        v = v.copy()
        for _ in range(_STEPS):
            self.graph.smooth_transposed(self.smoother, v)
        return np.asarray(self._restriction @ v)

    @cached_property
    def _restriction(self) -> bsr_matrix:
        return self.tentative.T.tobsr()


def aggregate(graph: NeighbourGraph, means: np.ndarray) -> Aggregates:
    """Aggregates of the Gaussians at means [N, 3]."""
    blocks = graph.own_blocks
    # neighbours that all lie on a line leave some gradients undetermined: the block is singular
    blocks = blocks + 1e-3 * np.trace(blocks, axis1=1, axis2=2)[:, None, None] / ROWS * np.eye(ROWS)
    inverse = np.linalg.inv(blocks)
    smoother = (inverse + inverse.transpose(0, 2, 1)) / 2
    damped = smoother * (_DAMPING / _largest_eigenvalue(graph, smoother.astype(np.float32)))
    tentative = _tentative(means, graph.mean_spacing).astype(np.float32)
    return Aggregates(graph, tentative, np.ascontiguousarray(damped, np.float32))


def _largest_eigenvalue(graph: NeighbourGraph, blocks: np.ndarray) -> float:
    """Estimate the largest eigenvalue of M K by power iteration on three random fields."""
    x = np.random.default_rng(0).normal(size=(ROWS * len(blocks), 3)).astype(np.float32)
    for _ in range(_POWER_STEPS):
        x /= np.linalg.norm(x, axis=0)
        product = np.zeros_like(x)
        graph.add_prior(x, 1.0, 0.0, product)
        x = times_blocks(blocks, product)
    return float(np.linalg.norm(x, axis=0).max())


def _tentative(means: np.ndarray, spacing: float) -> bsr_matrix:
    """Return [4N, 4G]: of each aggregate a displacement and its change along x, y, z, about the aggregate's mean."""
    n, regions = len(means), _split(means)
    column, blocks = np.empty(n, np.int32), np.tile(np.eye(ROWS), (n, 1, 1))
    for g, members in enumerate(regions):
        column[members], blocks[members, 0, 1:] = g, (means[members] - means[members].mean(0)) / spacing
    return bsr_matrix((blocks, column, np.arange(n + 1)), shape=(ROWS * n, ROWS * len(regions)))


def _split(means: np.ndarray) -> list[np.ndarray]:
    """Split by a k-d tree along the longest side: at most `MOST` regions of `_LEAST` Gaussians or more, or one."""
    regions = [np.arange(len(means))]
    while 2 * len(regions) <= MOST and len(regions[0]) >= 2 * _LEAST:
        halves = []
        for rows in regions:
            axis = int(np.ptp(means[rows], axis=0).argmax())
            order = rows[np.argsort(means[rows, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        regions = halves
    return regions


@dataclass(frozen=True)
class TwoLevelPreconditioner:
    """B of x = B θ: θ [P, 3] holds 4 N rows of the fine level, then 4 G of the coarse one."""

    blocks: np.ndarray  # [N, 4, 4] float32: roots of the inverse diagonal blocks
    aggregates: Aggregates
    coarse_factor: np.ndarray  # [4G, 4G] float32: a root of the inverse coarse operator

    def field(self, theta: np.ndarray) -> np.ndarray:
        """θ [P, 3] -> x [4N, 3] float32."""
        fine = ROWS * len(self.blocks)
        x = self.aggregates.field(self.coarse_factor @ theta[fine:])
        return times_blocks(self._transposed, theta[:fine], onto=x)

    def from_field(self, v: np.ndarray) -> np.ndarray:
        """The transpose of `field`: v [4N, 3] float32 -> [P, 3]."""
        fine = times_blocks(self.blocks, v)
        return np.concatenate([fine, self.coarse_factor.T @ self.aggregates.from_field(v)])

    @cached_property
    def _transposed(self) -> np.ndarray:
        return np.ascontiguousarray(self.blocks.transpose(0, 2, 1))


@dataclass(frozen=True)
class DiagonalEstimate:
    """The images' part of both levels, JᵀWJ on fields, independent of the prior's weight."""

    scale: float  # mean of its diagonal over coordinates of displacement
    diagonal: np.ndarray  # [4N] float64
    coarse: np.ndarray  # [4G, 4G] float64

    @staticmethod
    def of(aggregates: Aggregates, probes: np.ndarray) -> "DiagonalEstimate":
        """Estimate the diagonal from `probe` [probes, N, 6].

        Neighbours share pixels, so JᵀWJ has entries off the diagonal, and on most coarse fields it is two to three
        times its diagonal's part. That factor is estimated from the same probes.
        """
        per_gaussian = information(probes)
        diagonal = np.empty((len(per_gaussian), ROWS))
        diagonal[:, 0] = per_gaussian[:, 0]
        # a rotation is half the curl
        diagonal[:, 1:] = per_gaussian[:, 1:] / (4 * aggregates.graph.mean_spacing**2)
        coarse = aggregates.galerkin(diagonal.ravel())
        factor = _off_diagonal_factor(aggregates, probes, coarse.diagonal())
        coarse *= np.sqrt(factor[:, None] * factor)
        return DiagonalEstimate(float(per_gaussian[:, 0].mean()), diagonal.ravel(), coarse)


def _off_diagonal_factor(aggregates: Aggregates, probes: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """Return [4G]: coarse diagonal of JᵀWJ, by the probes, over that of its diagonal's part, [4G].

    Eight probes estimate the factor to a third, hence the geometric mean with the median of all; and twice that, since
    the two levels add up. Both chosen by iteration counts. Where no view sees most aggregates the factor is 0: then
    the prior alone makes the coarse level, which costs iterations and no accuracy.
    """
    fields = (aggregates.from_field(aggregates.graph.from_motion(p)).astype(np.float64) for p in probes)
    factor = sum((v**2).mean(1) for v in fields) / len(probes) / np.maximum(diagonal, 1e-300)
    return np.asarray(2 * np.sqrt(factor * np.median(factor)))


def probe(
    views: Sequence[ViewJacobian],
    n: int,
    rng: np.random.Generator,
    weights: np.ndarray | None = None,
    probes: int = PROBES,
) -> np.ndarray:
    """Return [probes, N, DOF] float32: Jᵀ W^½ z of Rademacher pictures z, whose mean outer product is JᵀWJ."""
    v_motions, buffers = np.zeros((probes, n, DOF), np.float32), Buffers()
    for k, view in enumerate(views):
        shape = (probes, *view.transmittance.shape, 3)
        signs = (rng.integers(0, 2, shape, np.int8) * 2 - 1).astype(np.float32)
        view.vjp(signs if weights is None else signs * np.sqrt(weights[k, ..., None]), v_motions, buffers)
    return v_motions


def information(probes: np.ndarray) -> np.ndarray:
    """Return [N, 2]: the diagonal of JᵀWJ (Fisher information) by displacement and by rotation, mean over x, y, z.

    From `probe`: the mean of (Jᵀ W^½ z)² is an unbiased estimate of that diagonal.
    """
    squares = (probes.astype(np.float64) ** 2).mean(0)
    return np.asarray(squares.reshape(len(squares), 2, 3).mean(2))


def two_level_preconditioner(
    aggregates: Aggregates, estimate: DiagonalEstimate, prior: float, ridge: float
) -> TwoLevelPreconditioner:
    """Return the preconditioner of the operator JᵀWJ + prior · K + ridge · I on fields."""
    n = len(aggregates.smoother)
    blocks = prior * aggregates.graph.own_blocks
    blocks[:, range(ROWS), range(ROWS)] += (_PATCH * estimate.diagonal + ridge).reshape(n, ROWS)
    inverse = _inverse(np.linalg.cholesky(blocks)).transpose(0, 2, 1)
    coarse = prior * aggregates.stiffness + estimate.coarse + ridge * aggregates.gram
    return TwoLevelPreconditioner(
        np.ascontiguousarray(inverse, np.float32), aggregates, _inverse_root(coarse)
    )


def _inverse_root(matrix: np.ndarray) -> np.ndarray:
    """R [P, P] float32 with R Rᵀ the inverse of a symmetric positive definite `matrix`.

    By torch: scipy's BLAS threads spin while they wait, which on a busy machine took 1.7 s for 1024 rows, not 0.03.
    """
    lower = torch.linalg.cholesky(torch.from_numpy(matrix)).float()
    return np.ascontiguousarray(_inverse_lower(lower).T.numpy())


def _inverse_lower(lower: torch.Tensor) -> torch.Tensor:
    """Invert a lower triangular matrix by recursive halves: half the time of a triangular solve for the unit matrix."""
    half = len(lower) // 2
    if half < 128:
        return torch.linalg.solve_triangular(lower, torch.eye(len(lower)), upper=False)
    out = torch.zeros_like(lower)
    out[:half, :half], out[half:, half:] = (
        _inverse_lower(lower[s, s]) for s in (slice(half), slice(half, None))
    )
    out[half:, :half] = -(out[half:, half:] @ lower[half:, :half]) @ out[:half, :half]
    return out


def _inverse(lower: np.ndarray) -> np.ndarray:
    """Invert lower triangular matrices [N, 4, 4] by forward substitution.

    An eighth of the time of a general inverse.
    """
    out = np.zeros_like(lower)
    for i in range(ROWS):
        out[:, i, i] = 1 / lower[:, i, i]
        for j in range(i):
            out[:, i, j] = -out[:, i, i] * np.einsum("nk,nk->n", lower[:, i, j:i], out[:, j:i, j])
    return out
