"""The least-squares problem of a temporal component: data, neighbours and prior, as one symmetric operator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix

from tg4mm.motion.config import MotionConfig
from tg4mm.motion.linear import DOF, RestView
from tg4mm.motion.neighbours import Neighbourhoods
from tg4mm.rasterize.buffers import Buffers


@dataclass(frozen=True)
class MotionProblem:
    """Find θ [P, 3] so that the displacement u = S θ [N, 3], with the rotation it implies, explains the images.

    Minimises Σ_views |J (u, Cu) − D|² + h (λ u·Ku + μ |θ|²), where h is the mean over Gaussians of what the
    images say about one coordinate, so that λ and μ do not depend on size, contrast or number of the images.
    """

    views: list[RestView]
    sampling: csr_matrix  # S [N, P]
    around: Neighbourhoods  # K and C
    scale: float  # h
    config: MotionConfig
    buffers: Buffers = field(default_factory=Buffers, compare=False)

    @property
    def n_parameters(self) -> int:
        return self.sampling.shape[1]

    def of_views(self, rows: np.ndarray) -> MotionProblem:
        """The problem that only some of the views pose, the prior weaker in proportion: alike but for the noise."""
        return replace(
            self, views=[self.views[i] for i in rows], scale=self.scale * len(rows) / len(self.views)
        )

    def field(self, theta: np.ndarray) -> np.ndarray:
        """θ [P, 3] -> displacement and rotation [N, DOF] float32."""
        u = self.sampling @ theta
        return with_rotation(u, self.around)

    def normal(self, theta: np.ndarray) -> np.ndarray:
        """The symmetric operator of the problem applied to θ [P, 3]."""
        return self.normals([theta])[0]

    def normals(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        """`normal` of several θ, in one pass over the views."""
        motions = np.stack([self.field(theta) for theta in thetas])
        v_motions = np.zeros_like(motions)
        for view in self.views:
            view.pull_all(view.push_all(motions, self.buffers), v_motions, self.buffers)
        return [self._with_prior(*parts) for parts in zip(thetas, motions, v_motions, strict=True)]

    def _with_prior(self, theta: np.ndarray, motion: np.ndarray, v_motion: np.ndarray) -> np.ndarray:
        v_u = self._to_displacement(v_motion)
        v_u += self.scale * self.config.neighbours * self.around.stiffness(motion[:, :3])
        return self.sampling.T @ v_u + self.scale * self.config.ridge * theta

    def right_hand_side(self, pictures: np.ndarray) -> np.ndarray:
        """The transposed operator applied to component images [V, H, W, 3]: [P, 3]."""
        return self.right_hand_sides(pictures[:, None])[0]

    def right_hand_sides(self, pictures: np.ndarray) -> list[np.ndarray]:
        """`right_hand_side` of R components [V, R, H, W, 3], in one pass over the views."""
        v_motions = np.zeros((pictures.shape[1], self.sampling.shape[0], DOF), np.float32)
        for view, shown in zip(self.views, pictures, strict=True):
            view.pull_all(shown, v_motions, self.buffers)
        return [self.sampling.T @ self._to_displacement(v_motion) for v_motion in v_motions]

    def _to_displacement(self, v_motion: np.ndarray) -> np.ndarray:
        return v_motion[:, :3] + self.around.from_rotations(v_motion[:, 3:])


def with_rotation(u: np.ndarray, around: Neighbourhoods) -> np.ndarray:
    """Displacement [N, 3] and the rotation vectors it implies, [N, DOF] float32."""
    u = np.ascontiguousarray(u, np.float32)
    return np.concatenate([u, around.rotations(u)], 1)


def information_scale(views: list[RestView], n: int, rng: np.random.Generator, probes: int = 2) -> float:
    """Mean over Gaussians and coordinates of the diagonal of JᵀJ for displacement, by random signs (Hutchinson)."""
    total = 0.0
    for _ in range(probes):
        motion = np.zeros((n, DOF), np.float32)
        motion[:, :3] = rng.choice(np.array([-1, 1], np.float32), (n, 3))
        total += sum(float((view.push(motion).astype(np.float64) ** 2).sum()) for view in views)
    return total / (probes * 3 * n)
