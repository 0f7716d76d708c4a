"""The least-squares problem of a temporal component: data, neighbours and prior, as one symmetric operator."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.prior.graph import Graph
from tg4mm.motion.solver.preconditioner import TwoLevelPreconditioner
from tg4mm.rasterize.buffers import Buffers


@dataclass(frozen=True)
class MotionProblem:
    """Find the field x [4N, 3], displacement u and its gradient, that explains the images.

    Minimises Σ_views Σ_pixels W |J m(x) − D|² + h (λ x·Kx + μ |x|²), where m is the motion of a field (displacement
    and rotation), K the graph's stiffness, and h the mean over Gaussians of what the images say about one coordinate of
    displacement, so that λ and μ do not depend on size, contrast or number of the images. The unknowns are θ [P, 3]
    with x = B θ (`preconditioner.py`), which conjugate gradients need few iterations for.
    """

    views: list[ViewJacobian]
    graph: Graph  # K and m
    levels: TwoLevelPreconditioner  # B
    scale: float  # h
    config: MotionConfig
    weights: np.ndarray | None = None  # W [V, H, W] float32; None: 1
    buffers: Buffers = field(default_factory=Buffers, compare=False)

    @property
    def n_parameters(self) -> int:
        return self.levels.n_parameters

    def of_views(self, rows: np.ndarray) -> MotionProblem:
        """The problem that only some of the views pose, the prior weaker in proportion: alike but for the noise."""
        weights = None if self.weights is None else self.weights[rows]
        share = len(rows) / len(self.views)
        return replace(self, views=[self.views[i] for i in rows], scale=self.scale * share, weights=weights)

    def field(self, theta: np.ndarray) -> np.ndarray:
        """θ [P, 3] -> displacement and rotation [N, DOF] float32."""
        return self.graph.motion(self.levels.field(theta))

    def rows(self, theta: np.ndarray) -> np.ndarray:
        """θ [P, 3] -> x [4N, 3] float32, displacements and their gradients."""
        return self.levels.field(theta)

    def with_graph(self, graph: Graph) -> MotionProblem:
        """The problem with other weights of edges, in the same unknowns."""
        return replace(self, graph=graph)

    def with_prior_of(self, other: MotionProblem) -> MotionProblem:
        """`with_graph` of another problem, whose memory it shares."""
        return self.with_graph(other.graph)

    def prior(self, x: np.ndarray) -> np.ndarray:
        """[P, 3]: what the prior alone adds to `normal` of the θ of a field x [4N, 3]."""
        return self.with_prior(x, np.zeros((self.graph.n_gaussians, DOF), np.float32))

    def normal(self, theta: np.ndarray) -> np.ndarray:
        """The symmetric operator of the problem applied to θ [P, 3]."""
        return self.normals([theta])[0]

    def normals(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        """`normal` of several θ, in one pass over the views."""
        return normals_of([self] * len(thetas), thetas)

    def with_prior(self, x: np.ndarray, v_motion: np.ndarray) -> np.ndarray:
        """`normal`, [P, 3], of the θ of a field x, given what the views say of its motion [N, DOF]."""
        v = self.graph.from_motion(v_motion)
        self.graph.add_prior(x, self.scale * self.config.neighbours, self.scale * self.config.ridge, v)
        return self.levels.from_field(v)

    def right_hand_side(self, pictures: np.ndarray) -> np.ndarray:
        """The transposed operator applied to component images [V, H, W, 3]: [P, 3]."""
        return self.right_hand_sides(pictures[:, None])[0]

    def right_hand_sides(self, pictures: Iterable[np.ndarray]) -> list[np.ndarray]:
        """`right_hand_side` of R components, of each view [R, H, W, 3], in one pass over the views."""
        return [self.to_parameters(v) for v in self.seen(pictures)]

    def seen(self, pictures: Iterable[np.ndarray]) -> np.ndarray:
        """What component images, of each view [R, H, W, 3], say of each Gaussian's motion, [R, N, DOF]."""
        v_motions = np.zeros((0, self.graph.n_gaussians, DOF), np.float32)
        for k, (view, shown) in enumerate(zip(self.views, pictures, strict=True)):
            if not k:
                v_motions = np.zeros((len(shown), *v_motions.shape[1:]), np.float32)
            view.vjp(self.weighted(k, shown), v_motions, self.buffers)
        return v_motions

    def to_parameters(self, v_motion: np.ndarray) -> np.ndarray:
        """The transpose of `field`: [N, DOF] -> [P, 3]."""
        return self.levels.from_field(self.graph.from_motion(v_motion))

    def misfits(self, fields: Sequence[np.ndarray], pictures: np.ndarray) -> np.ndarray:
        """[R] Σ W |difference|² between what R fields [N, DOF] show and component images [V, H, W, 3]."""
        total, motions = np.zeros(len(fields)), np.stack(fields)
        for k, (view, picture) in enumerate(zip(self.views, pictures, strict=True)):
            left = view.jvp(motions, self.buffers) - picture
            total += (left.astype(np.float64) * self.weighted(k, left)).sum((1, 2, 3))
        return total

    def weighted(self, k: int, pictures: np.ndarray) -> np.ndarray:
        """Pictures [R, H, W, 3] of view `k` times the weights of its pixels."""
        return pictures if self.weights is None else pictures * self.weights[k, ..., None]


def normals_of(problems: Sequence[MotionProblem], thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
    """`normal` of one θ each of problems that share their views, in one pass over these."""
    first = problems[0]
    fields = [p.levels.field(theta) for p, theta in zip(problems, thetas, strict=True)]
    motions = np.stack([first.graph.motion(x) for x in fields])
    v_motions = np.zeros_like(motions)
    for k, view in enumerate(first.views):
        weights = None if first.weights is None else first.weights[k]
        view.gauss_newton_product(motions, weights, v_motions, first.buffers)
    return [p.with_prior(x, v) for p, x, v in zip(problems, fields, v_motions, strict=True)]
