"""The neighbourhood of every Gaussian: which move alike, and the rotation that neighbours' displacements imply."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial import cKDTree

COUNT = 12  # neighbours of a Gaussian
_SINGULAR = 0.02  # principal inertia, as a share of the trace, below which rotation fades (a wire: no twist)


@dataclass(frozen=True)
class Neighbourhoods:
    """Linear operators on a displacement field [N, 3], float32."""

    rotation: csr_matrix  # [3N, 3N]: displacement (row-major [N, 3]) -> rotation vectors, radians
    _differences: csr_matrix  # [M, N]: √w_ij (u_j − u_i) for the M = N · count pairs
    _arms: np.ndarray  # [M, 3]: √w_ij (x_j − x_i)
    _owner: np.ndarray  # [M] i
    _scale: float  # 1 / mean diagonal of the unscaled stiffness

    def rotations(self, u: np.ndarray) -> np.ndarray:
        """[N, 3] displacement -> [N, 3] the rotation of every Gaussian's neighbourhood, radians."""
        return (self.rotation @ np.ascontiguousarray(u).ravel()).reshape(-1, 3)

    def from_rotations(self, v: np.ndarray) -> np.ndarray:
        """The transpose of `rotations`."""
        return (self.rotation.T @ np.ascontiguousarray(v).ravel()).reshape(-1, 3)

    def stiffness(self, u: np.ndarray) -> np.ndarray:
        """Gradient / 2 of Σ w_ij |u_j − u_i − ω_i × (x_j − x_i)|², ω_i as of `rotations`; mean diagonal 1.

        Rigid motions cost nothing; what bends or stretches does.
        """
        left = self._differences @ u - np.cross(self.rotations(u)[self._owner], self._arms)
        return (self._from_strains(left) * self._scale).astype(np.float32)

    def from_random_strains(self, rng: np.random.Generator) -> np.ndarray:
        """[N, 3] whose squares are the diagonal of `stiffness` on average."""
        signs = rng.choice(np.array([-1, 1], np.float32), self._arms.shape)
        return np.asarray(self._from_strains(signs) * np.float32(self._scale**0.5))

    def _from_strains(self, strains: np.ndarray) -> np.ndarray:
        """The transpose of u -> √w_ij (u_j − u_i − ω_i × (x_j − x_i)): [M, 3] -> [N, 3]."""
        turn = np.cross(self._arms, strains).reshape(self._differences.shape[1], -1, 3).sum(1)
        return np.asarray(self._differences.T @ strains - self.from_rotations(turn))


def neighbourhoods(means: np.ndarray, count: int = COUNT) -> Neighbourhoods:
    """Operators of the `count` nearest neighbours; means [N, 3] in scene units."""
    n = len(means)
    count = min(count, n - 1)
    distance, index = cKDTree(means).query(means, k=count + 1)
    distance, index = distance[:, 1:], index[:, 1:]
    reach = np.maximum(distance.mean(1, keepdims=True), 1e-12)
    weight = np.exp(-0.5 * (distance / reach) ** 2)
    root = np.sqrt(weight).ravel()
    owner, pair = np.repeat(np.arange(n), count), np.arange(n * count)
    entries = (
        np.concatenate([root, -root]),
        (np.concatenate([pair, pair]), np.concatenate([index.ravel(), owner])),
    )
    differences = coo_matrix(entries, shape=(n * count, n)).tocsr().astype(np.float32)
    arms = ((means[index] - means[:, None]).reshape(-1, 3) * root[:, None]).astype(np.float32)
    unscaled = Neighbourhoods(_rigid_rotation(means, index, weight), differences, arms, owner, 1.0)
    signs = np.random.default_rng(0).choice(np.array([-1, 1], np.float32), (n, 3))
    diagonal = float((signs * unscaled.stiffness(signs)).mean())  # Hutchinson's estimate of its mean
    return replace(unscaled, _scale=1 / diagonal)


def _cross_matrices(v: np.ndarray) -> np.ndarray:
    """[..., 3] -> [..., 3, 3], so that the matrix times u is v × u."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*v.shape[:-1], 3, 3)


def _rigid_rotation(means: np.ndarray, index: np.ndarray, weight: np.ndarray) -> csr_matrix:
    """The ω_i that minimises Σ_j w_ij |u_j − u_i − ω_i × (x_j − x_i)|², linear in u.

    Unlike a gradient fit this is well posed on a surface, where nothing is known along the normal.
    """
    n = len(means)
    arm = means[index] - means[:, None]
    cross = _cross_matrices(arm)
    inertia = np.einsum("nj,njab,njac->nbc", weight, cross, cross)  # Σ w (|d|² − d dᵀ)
    trace = np.trace(inertia, axis1=1, axis2=2)[:, None, None] + 1e-30
    # λ³ / (λ⁴ + ε⁴) of every principal inertia λ: its inverse to 1e-4 where λ > 10 ε (a plain ridge would take 6 % off
    # every rotation), but nothing where λ vanishes
    cubed = np.linalg.matrix_power(inertia / trace, 3)
    inverse = np.linalg.solve(cubed @ inertia / trace + _SINGULAR**4 * np.eye(3), cubed) / trace
    blocks = np.einsum("nab,nj,njbc->njac", inverse, weight, cross)  # [N, J, 3, 3]
    blocks = np.concatenate([blocks, -blocks.sum(1, keepdims=True)], 1)
    columns = np.concatenate([index, np.arange(n)[:, None]], 1)
    row = 3 * np.arange(n)[:, None, None, None] + np.arange(3)[:, None]
    column = 3 * columns[:, :, None, None] + np.arange(3)
    row, column = np.broadcast_to(row, blocks.shape), np.broadcast_to(column, blocks.shape)
    matrix = coo_matrix(
        (blocks.ravel().astype(np.float32), (row.ravel(), column.ravel())), shape=(3 * n, 3 * n)
    )
    return matrix.tocsr()
