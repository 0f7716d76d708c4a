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

    Minimises Σ_views |J (u, Cu) − D|² + h (λ u·Ku + μ Σ e² |θ|²), where h is the mean over Gaussians of what the
    images say about one coordinate, so that λ and μ do not depend on size, contrast or number of the images. e is 1
    until the parameters are scaled (`condition.py`).
    """

    views: list[RestView]
    sampling: csr_matrix  # S [N, P]
    around: Neighbourhoods  # K and C
    scale: float  # h
    config: MotionConfig
    damping: np.ndarray | float = 1.0  # e² [P]
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
        return normals_of([self] * len(thetas), thetas)

    def with_prior(self, theta: np.ndarray, motion: np.ndarray, v_motion: np.ndarray) -> np.ndarray:
        """`normal` of θ, given the motion it makes and what the views say of that, [N, DOF] each."""
        v_u = self.to_displacement(v_motion)
        v_u += self.scale * self.config.neighbours * self.around.stiffness(motion[:, :3])
        damping = self.scale * self.config.ridge * np.reshape(self.damping, (-1, 1))
        return self.to_parameters(v_u) + damping.astype(np.float32) * theta

    def right_hand_side(self, pictures: np.ndarray) -> np.ndarray:
        """The transposed operator applied to component images [V, H, W, 3]: [P, 3]."""
        return self.right_hand_sides(pictures[:, None])[0]

    def right_hand_sides(self, pictures: np.ndarray) -> list[np.ndarray]:
        """`right_hand_side` of R components [V, R, H, W, 3], in one pass over the views."""
        return [self.to_parameters(v_u) for v_u in self._seen(pictures)]

    def seen(self, pictures: np.ndarray) -> np.ndarray:
        """What component images [V, H, W, 3] say of each displacement, [N, 3]."""
        return self._seen(pictures[:, None])[0]

    def _seen(self, pictures: np.ndarray) -> list[np.ndarray]:
        v_motions = np.zeros((pictures.shape[1], self.sampling.shape[0], DOF), np.float32)
        for view, shown in zip(self.views, pictures, strict=True):
            view.pull_all(shown, v_motions, self.buffers)
        return [self.to_displacement(v_motion) for v_motion in v_motions]

    def to_parameters(self, v_u: np.ndarray) -> np.ndarray:
        """The transpose of θ -> u: [N, 3] -> [P, 3]."""
        return np.asarray(self.sampling.T @ v_u)

    def misfits(self, fields: Sequence[np.ndarray], pictures: np.ndarray) -> np.ndarray:
        """[R] squared differences between what R fields [N, DOF] show and component images [V, H, W, 3]."""
        total, motions = np.zeros(len(fields)), np.stack(fields)
        for view, picture in zip(self.views, pictures, strict=True):
            left = view.push_all(motions, self.buffers) - picture
            total += (left.astype(np.float64) ** 2).sum((1, 2, 3))
        return total

    def to_displacement(self, v_motion: np.ndarray) -> np.ndarray:
        """What displacement and rotation [N, DOF] say of the displacement alone [N, 3], which the rotation follows."""
        return v_motion[:, :3] + self.around.from_rotations(v_motion[:, 3:])


def normals_of(problems: Sequence[MotionProblem], thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
    """`normal` of one θ each of problems that share their views, in one pass over these."""
    motions = np.stack([p.field(theta) for p, theta in zip(problems, thetas, strict=True)])
    v_motions, buffers = np.zeros_like(motions), problems[0].buffers
    for view in problems[0].views:
        view.pull_all(view.push_all(motions, buffers), v_motions, buffers)
    parts = zip(problems, thetas, motions, v_motions, strict=True)
    return [p.with_prior(theta, motion, v_motion) for p, theta, motion, v_motion in parts]


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
