"""An additive multilevel Schwarz preconditioner, so that conjugate gradients need few iterations.

What the images determine well converges in a few iterations; a whole part that sways costs the prior hardly anything
and takes hundreds, since each iteration couples a Gaussian to its neighbours only. The fine level is block Jacobi, one
4 × 4 block a Gaussian; the coarse level the Galerkin operator on regions. Both enter by a root of their inverse as a
change of variables x = B θ, which needs no change to conjugate gradients.

The coarse space is smoothed aggregation on the prior (Vaněk, Mandel & Brezina 1996). Gaussians are split into
regions. A tentative coarse field is linear in space inside one region, which costs the prior nothing there, and 0
elsewhere, which costs much at its border. Damped Jacobi steps of the prior's matrix smooth it.

Such steps are as wide as a Gaussian's neighbourhood, which does little for a large region. From 64 Gaussians on it is
made of patches of 16 to 31: fields of patches are smoothed on Gaussians, those of regions on patches, by the prior's
Galerkin operator there. Its blocks on the diagonal make the patches a level of their own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import bsr_matrix

from tg4mm.core.memory import Buffers
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian
from tg4mm.fit.motion.prior import ROWS, NeighbourGraph, times_blocks

MOST = 256  # regions: the coarse operator is dense, with four times as many rows
_LEAST = 16  # Gaussians of a region or patch
_STEPS = 2  # Jacobi steps of a region's field
_DAMPING = 4 / 3  # over the largest eigenvalue: damps the upper half of the spectrum most evenly
_POWER_STEPS = 15  # for that eigenvalue
PROBES = 8  # random pictures to estimate the diagonal of JᵀWJ: 50 % deviation, enough for a preconditioner
# Factor on the fine level's diagonal of JᵀWJ. Groups of Gaussians smaller than a region or patch share pixels but have
# no level of their own; the diagonal alone underestimates what the images determine of them. Chosen by iteration
# counts; with patches 2 to 32 give the same.
_SHARED = 32.0


# What is used of a matrix's Galerkin operators: blocks [M, 4, 4] on the diagonal of patches; all [1, 4G, 4G] of regions
Levels = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Aggregates:
    """The prolongation of G regions: fields [4G, 3] -> of M patches [4M, 3] -> [4N, 3]. M = G if N is small."""

    graph: NeighbourGraph
    tentative: bsr_matrix  # [4N, 4M] float32: of patches, before smoothing, one 4 × 4 block a Gaussian
    tentative_regions: bsr_matrix  # [4M, 4G] float32: the same of regions, one block a patch
    smoother: np.ndarray  # [N, 4, 4] float32, symmetric: damped inverse of the prior's diagonal blocks

    @property
    def has_patches(self) -> bool:
        """Return whether regions are made of patches."""
        return bool(self.tentative_regions.shape[0] > self.tentative_regions.shape[1])

    @property
    def labels(self) -> np.ndarray:
        """Return [N] int: the region of every Gaussian."""
        return np.asarray(self.tentative_regions.indices[self.tentative.indices])

    @property
    def _steps(self) -> range:
        """Jacobi steps on Gaussians: for patches one suffices, since regions take theirs on patches."""
        return range(1 if self.has_patches else _STEPS)

    @cached_property
    def matrix(self) -> bsr_matrix:
        """Patches to Gaussians [4N, 4M] float64."""
        out = self.tentative.astype(np.float64)
        for _ in self._steps:
            out = out - _block_diagonal(self.smoother.astype(np.float64)) @ (self.graph.blocks @ out)
        return out

    @cached_property
    def regions(self) -> bsr_matrix:
        """Regions to patches [4M, 4G] float32; the identity where these are the same."""
        if not self.has_patches:
            return self.tentative_regions
        prior, out = self._on_patches(self.graph.blocks), self.tentative_regions.astype(np.float64)
        smoother = _block_diagonal(_smoother(_own_blocks(prior), prior.__matmul__))
        for _ in range(_STEPS):
            out = out - smoother @ (prior @ out)
        return out.astype(np.float32)

    @cached_property
    def stiffness(self) -> Levels:
        """Return `galerkin` of the prior's matrix K."""
        return self.galerkin(self.graph.blocks)

    @cached_property
    def gram(self) -> Levels:
        """Return `galerkin` of the unit matrix."""
        return self.galerkin(_block_diagonal(np.tile(np.eye(ROWS), (len(self.smoother), 1, 1))))

    def galerkin(self, matrix: bsr_matrix) -> Levels:
        """Return what levels use of the Galerkin operators of a matrix [4N, 4N]."""
        on_patches, regions = self._on_patches(matrix), self.regions.astype(np.float64)
        return _own_blocks(on_patches), (regions.T @ (on_patches @ regions)).toarray()[None]

    def _on_patches(self, matrix: bsr_matrix) -> bsr_matrix:
        return (self.matrix.T @ (matrix @ self.matrix)).tobsr((ROWS, ROWS))

    def field(self, patches: np.ndarray, regions: np.ndarray) -> np.ndarray:
        """Fields of patches [4M, 3] and regions [4G, 3] float32 -> their sum [4N, 3] float32."""
        x = self.tentative @ (patches + self.regions @ regions)
        for _ in self._steps:
            x = self.graph.smoothed(self.smoother, x)
        return np.asarray(x)

    def from_field(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The transpose of `field`."""
        v = v.copy()
        for _ in self._steps:
            self.graph.smooth_transposed(self.smoother, v)
        to_patches, to_regions = self._transposed
        patches = np.asarray(to_patches @ v)
        return patches, np.asarray(to_regions @ patches)

    @cached_property
    def _transposed(self) -> tuple[bsr_matrix, bsr_matrix]:
        return self.tentative.T.tobsr(), self.regions.T.tobsr()


def aggregate(graph: NeighbourGraph, means: np.ndarray) -> Aggregates:
    """Aggregates of the Gaussians at means [N, 3]."""

    def prior_times(x: np.ndarray) -> np.ndarray:
        product = np.zeros_like(x)
        graph.add_prior(x, 1.0, 0.0, product)
        return product

    smoother = np.ascontiguousarray(_smoother(graph.own_blocks, prior_times), np.float32)
    regions = _split(means, [np.arange(len(means))], MOST)
    patches = _split(means, regions, len(means))
    if len(patches) < 4 * len(regions):
        patches = regions
    tentative, centres = _tentative(means, patches, graph.mean_spacing)
    of_regions = list(np.arange(len(patches)).reshape(len(regions), -1))
    return Aggregates(graph, tentative, _tentative(centres, of_regions, graph.mean_spacing)[0], smoother)


def _smoother(blocks: np.ndarray, times: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return [n, 4, 4], symmetric: damped inverse of the diagonal blocks of a matrix, whose products are `times`.

    Its largest eigenvalue is estimated by power iteration on three random fields.
    """
    # neighbours that all lie on a line leave some gradients undetermined: the block is singular
    blocks = blocks + 1e-3 * np.trace(blocks, axis1=1, axis2=2)[:, None, None] / ROWS * np.eye(ROWS)
    inverse = np.linalg.inv(blocks)
    inverse = (inverse + inverse.transpose(0, 2, 1)) / 2
    x = np.random.default_rng(0).normal(size=(ROWS * len(blocks), 3)).astype(np.float32)
    for _ in range(_POWER_STEPS):
        x /= np.linalg.norm(x, axis=0)
        x = times_blocks(inverse.astype(np.float32), times(x).astype(np.float32))
    return np.asarray(inverse * (_DAMPING / float(np.linalg.norm(x, axis=0).max())))


def _block_diagonal(blocks: np.ndarray) -> bsr_matrix:
    return bsr_matrix((blocks, np.arange(len(blocks)), np.arange(len(blocks) + 1)))


def _own_blocks(matrix: bsr_matrix) -> np.ndarray:
    """Return [n, 4, 4] on the diagonal of a matrix [4n, 4n]."""
    rows = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
    out, own = np.zeros((len(matrix.indptr) - 1, ROWS, ROWS)), rows == matrix.indices
    out[rows[own]] = matrix.data[own]
    return out


def _tentative(
    means: np.ndarray, regions: Sequence[np.ndarray], spacing: float
) -> tuple[bsr_matrix, np.ndarray]:
    """Return [4n, 4G] float32 and [G, 3]: of each of `regions` a displacement and its change along x, y, z; its mean.

    Of n fields at means [n, 3], about the mean of a region's. `spacing`: the unit of length of gradients.
    """
    n, centres = len(means), np.stack([means[members].mean(0) for members in regions])
    column, blocks = np.empty(n, np.int32), np.tile(np.eye(ROWS), (n, 1, 1))
    for g, members in enumerate(regions):
        column[members], blocks[members, 0, 1:] = g, (means[members] - centres[g]) / spacing
    blocks = blocks.astype(np.float32)
    return bsr_matrix((blocks, column, np.arange(n + 1)), shape=(ROWS * n, ROWS * len(regions))), centres


def _split(means: np.ndarray, regions: list[np.ndarray], most: int) -> list[np.ndarray]:
    """Split by a k-d tree along the longest side: at most `most` regions of `_LEAST` Gaussians or more, or as they are.

    Those made of region g follow one another.
    """
    while 2 * len(regions) <= most and len(regions[0]) >= 2 * _LEAST:
        halves = []
        for rows in regions:
            axis = int(np.ptp(means[rows], axis=0).argmax())
            order = rows[np.argsort(means[rows, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        regions = halves
    return regions


@dataclass(frozen=True)
class MultilevelPreconditioner:
    """B of x = B θ: θ [P, 3] holds 4 N rows of the fine level, 4 M of the patches, 4 G of the regions."""

    blocks: np.ndarray  # [N, 4, 4] float32: roots of the inverse diagonal blocks
    aggregates: Aggregates
    patch_blocks: np.ndarray  # [M, 4, 4] float32: the same of patches; 0 where these are the regions
    coarse_factor: np.ndarray  # [4G, 4G] float32: a root of the inverse coarse operator

    @property
    def levels(self) -> tuple[slice, slice, slice]:
        """Rows of θ."""
        fine, patches = ROWS * len(self.blocks), ROWS * len(self.patch_blocks)
        return slice(fine), slice(fine, fine + patches), slice(fine + patches, None)

    def field(self, theta: np.ndarray) -> np.ndarray:
        """θ [P, 3] -> x [4N, 3] float32."""
        fine, patches, regions = (theta[rows] for rows in self.levels)
        patches = times_blocks(self._transposed[1], patches)
        x = self.aggregates.field(patches, self.coarse_factor @ regions)
        return times_blocks(self._transposed[0], fine, onto=x)

    def from_field(self, v: np.ndarray) -> np.ndarray:
        """The transpose of `field`: v [4N, 3] float32 -> [P, 3]."""
        patches, regions = self.aggregates.from_field(v)
        fine, patches = times_blocks(self.blocks, v), times_blocks(self.patch_blocks, patches)
        return np.concatenate([fine, patches, self.coarse_factor.T @ regions])

    @cached_property
    def _transposed(self) -> list[np.ndarray]:
        return [np.ascontiguousarray(b.transpose(0, 2, 1)) for b in (self.blocks, self.patch_blocks)]


@dataclass(frozen=True)
class DiagonalEstimate:
    """The images' part of all levels, JᵀWJ on fields, independent of the prior's weight."""

    scale: float  # mean of its diagonal over coordinates of displacement
    diagonal: np.ndarray  # [4N] float64
    coarse: Levels

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
        coarse = aggregates.galerkin(_block_diagonal(diagonal[..., None] * np.eye(ROWS)))
        seen = [aggregates.from_field(aggregates.graph.from_motion(p)) for p in probes]
        for blocks, of_level in zip(coarse, zip(*seen, strict=True), strict=True):
            own = np.einsum("nii->ni", blocks)
            root = np.sqrt(_off_diagonal_factor(of_level, own.ravel())).reshape(own.shape)
            blocks *= root[:, :, None] * root[:, None]
        return DiagonalEstimate(float(per_gaussian[:, 0].mean()), diagonal.ravel(), coarse)


def _off_diagonal_factor(probes: Sequence[np.ndarray], diagonal: np.ndarray) -> np.ndarray:
    """Return [P]: the diagonal of JᵀWJ on a level, by its `probes` [P, 3], over that of its diagonal's part, [P].

    Eight probes estimate the factor to a third, hence the geometric mean with the median of all; and twice that, since
    the levels add up. Both chosen by iteration counts. Where no view sees most aggregates the factor is 0: then
    the prior alone makes the level, which costs iterations and no accuracy.
    """
    squares = sum((v.astype(np.float64) ** 2).mean(1) for v in probes)
    factor = squares / len(probes) / np.maximum(diagonal, 1e-300)
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


def multilevel_preconditioner(
    aggregates: Aggregates, estimate: DiagonalEstimate, prior: float, ridge: float
) -> MultilevelPreconditioner:
    """Return the preconditioner of the operator JᵀWJ + prior · K + ridge · I on fields."""
    n = len(aggregates.smoother)
    blocks = prior * aggregates.graph.own_blocks
    blocks[:, range(ROWS), range(ROWS)] += (_SHARED * estimate.diagonal + ridge).reshape(n, ROWS)
    each = zip(aggregates.stiffness, estimate.coarse, aggregates.gram, strict=True)
    patches, regions = (prior * stiffness + images + ridge * gram for stiffness, images, gram in each)
    of_patches = _block_roots(patches) if aggregates.has_patches else np.zeros(patches.shape, np.float32)
    return MultilevelPreconditioner(_block_roots(blocks), aggregates, of_patches, _inverse_root(regions[0]))


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


def _block_roots(blocks: np.ndarray) -> np.ndarray:
    """Return [n, 4, 4] float32: R with R Rᵀ the inverse of each of `blocks`.

    By forward substitution: an eighth of the time of a general inverse.
    """
    lower = np.linalg.cholesky(blocks)
    out = np.zeros_like(lower)
    for i in range(ROWS):
        out[:, i, i] = 1 / lower[:, i, i]
        for j in range(i):
            out[:, i, j] = -out[:, i, i] * np.einsum("nk,nk->n", lower[:, i, j:i], out[:, j:i, j])
    return np.ascontiguousarray(out.transpose(0, 2, 1), np.float32)
