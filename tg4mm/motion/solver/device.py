"""The motion stage's problem on a torch device: the same Jacobian, as a list of pixel–Gaussian contributions.

gsplat has no forward mode, and its cut-off of small alphas is compiled in at 1/255, which makes faint Gaussians
answer too weakly (`view.py`); a difference of two renders would not be the transpose of its backward pass. But
the problem is linearised at rest once: every contribution of a Gaussian to a pixel has one weight (what the Gaussian's
colour does there) and one slope (what its exponent does), which stay the same through all iterations. The CPU
kernels project and sort each view once; the contributions are listed on the device, and from then on nothing is
rendered and nothing leaves the device but the three sums of a step of conjugate gradients.

Weights and slopes are kept in float16 on CUDA, sums are taken in float32: `jvp` and `vjp` read the same rounded
numbers, so the operator stays symmetric, and 5e-4 on single entries is far below the noise of the images. A
contribution takes 16 bytes then.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from tg4mm.errors import Tg4mmError
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.contributions import DeviceViewJacobian, device_view_jacobian
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.prior.graph import Graph
from tg4mm.motion.prior.tgv import ROWS
from tg4mm.motion.solver.problem import MotionProblem


def _sparse(matrix: csr_matrix, device: str) -> Tensor:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        matrix = matrix.sorted_indices()
        arrays = (matrix.indptr, matrix.indices, matrix.data.astype(np.float32))
        start, column, value = (torch.from_numpy(np.array(a)) for a in arrays)
        size = (matrix.shape[0], matrix.shape[1])
        return torch.sparse_csr_tensor(start, column, value, size, check_invariants=True).to(device)


def _too_small(device: str, holds: str) -> Tg4mmError:
    return Tg4mmError(
        f"the motion stage needs more memory than device {device} has: {holds}; "
        "--device cpu needs none of it and takes up the same run"
    )


@dataclass(frozen=True)
class _Operator:
    """A sparse matrix and its transpose, each stored by rows."""

    forward: Tensor
    back: Tensor

    @staticmethod
    def of(matrix: csr_matrix, device: str) -> _Operator:
        return _Operator(_sparse(matrix, device), _sparse(matrix.T.tocsr(), device))


class DeviceProblem:
    """`MotionProblem` on a device: the same names, tensors in place of arrays."""

    def __init__(self, problem: MotionProblem, device: str, storage: torch.dtype | None = None) -> None:
        """`storage` of weights and slopes: None for float16 on CUDA, float32 elsewhere.

        Raises Tg4mmError where the device's memory does not hold the views.
        """
        if storage is None:
            storage = torch.float16 if device == "cuda" else torch.float32
        self.device = device
        graph = problem.graph
        self.stiffness = _sparse(graph.stiffness, device)
        self._turns = torch.from_numpy(graph.gradient_to_rotation).to(device)
        self._take_parameters(problem)
        self.views: list[DeviceViewJacobian] = []
        try:
            for view in problem.views:
                self.views.append(device_view_jacobian(view, device, storage))
        except torch.OutOfMemoryError:
            raise _too_small(device, f"it holds {len(self.views)} of {len(problem.views)} views") from None

    def _take_parameters(self, problem: MotionProblem) -> None:
        self.config: MotionConfig = problem.config
        self.scale, known = problem.scale, problem.levels
        self.blocks = torch.from_numpy(known.blocks).to(self.device)
        self.groups = _Operator.of(known.aggregates.matrix.tocsr(), self.device)
        self.turn = torch.from_numpy(known.coarse_factor).to(self.device)
        self.weights = None if problem.weights is None else self._there(problem.weights[..., None])

    def posed_as(self, problem: MotionProblem) -> DeviceProblem:
        """The same views and neighbours with the unknowns and weights of `problem`; shares their memory."""
        other = copy.copy(self)
        other._take_parameters(problem)
        return other

    def of_views(self, rows: np.ndarray) -> DeviceProblem:
        """As `MotionProblem.of_views`; shares all memory but the pixels' weights."""
        some = copy.copy(self)
        some.views = [self.views[i] for i in rows]
        some.scale = self.scale * len(rows) / len(self.views)
        if self.weights is not None:
            some.weights = self.weights[torch.from_numpy(np.asarray(rows)).to(self.device)]
        return some

    def _field(self, theta: Tensor) -> Tensor:
        """As `TwoLevelPreconditioner.field`."""
        fine = ROWS * len(self.blocks)
        x = (self.blocks @ theta[:fine].reshape(-1, ROWS, 3)).reshape(-1, 3)
        return x + self.groups.forward @ (self.turn @ theta[fine:])

    def _from_field(self, v: Tensor) -> Tensor:
        """As `TwoLevelPreconditioner.from_field`."""
        fine = (self.blocks.mT @ v.reshape(-1, ROWS, 3)).reshape(-1, 3)
        return torch.cat([fine, self.turn.T @ (self.groups.back @ v)])

    def _motion(self, x: Tensor) -> Tensor:
        """As `Graph.motion`."""
        f = x.reshape(-1, ROWS, 3)
        return torch.cat([f[:, 0], (f[:, 1:].reshape(-1, 1, 9) @ self._turns)[:, 0]], 1)

    def _from_motion(self, v_motion: Tensor) -> Tensor:
        """As `Graph.from_motion`."""
        gradient = (self._turns @ v_motion[:, 3:, None]).reshape(-1, 3, 3)
        return torch.cat([v_motion[:, None, :3], gradient], 1).reshape(-1, 3)

    def field(self, theta: Tensor) -> Tensor:
        """θ [P, 3] -> displacement and rotation [N, DOF] float32."""
        return self._motion(self._field(theta))

    def rows(self, theta: Tensor) -> Tensor:
        """As `MotionProblem.rows`."""
        return self._field(theta)

    def with_graph(self, graph: Graph) -> DeviceProblem:
        """As `MotionProblem.with_graph`."""
        other = copy.copy(self)
        try:
            other.stiffness = _sparse(graph.stiffness, self.device)
        except torch.OutOfMemoryError:
            raise _too_small(self.device, "it holds one matrix of the neighbours, not two") from None
        return other

    def with_prior_of(self, other: DeviceProblem) -> DeviceProblem:
        """As `MotionProblem.with_prior_of`."""
        same = copy.copy(self)
        same.stiffness = other.stiffness
        return same

    def prior(self, x: np.ndarray) -> Tensor:
        """As `MotionProblem.prior`."""
        return self._from_field(self._drawn(self._there(x)))

    def _drawn(self, x: Tensor) -> Tensor:
        return self.scale * (self.config.neighbours * (self.stiffness @ x) + self.config.ridge * x)

    def normal(self, theta: Tensor) -> Tensor:
        """The symmetric operator of the problem applied to θ [P, 3]."""
        x = self._field(theta)
        motion = self._motion(x)
        v_motion = torch.zeros_like(motion)
        for k, view in enumerate(self.views):
            view.vjp(self._weighted(k, view.jvp(motion)), v_motion)
        return self._from_field(self._from_motion(v_motion) + self._drawn(x))

    def normals(self, thetas: Sequence[Tensor]) -> list[Tensor]:
        """As `MotionProblem.normals`, one after the other."""
        return [self.normal(theta) for theta in thetas]

    def right_hand_side(self, pictures: np.ndarray) -> Tensor:
        """The transposed operator applied to component images [V, H, W, 3]: [P, 3]."""
        return self.right_hand_sides(pictures[:, None])[0]

    def right_hand_sides(self, pictures: Iterable[np.ndarray]) -> list[Tensor]:
        """As `MotionProblem.right_hand_sides`."""
        return [self.to_parameters(v) for v in self.seen(pictures)]

    def seen(self, pictures: Iterable[np.ndarray]) -> list[Tensor]:
        """As `MotionProblem.seen`: R of [N, DOF]."""
        out: list[Tensor] = []
        for k, (view, shown) in enumerate(zip(self.views, pictures, strict=True)):
            out = out or [torch.zeros(len(self.blocks), DOF, device=self.device) for _ in shown]
            for picture, v_motion in zip(shown, out, strict=True):
                view.vjp(self._weighted(k, self._there(picture)), v_motion)
        return out

    def to_parameters(self, v_motion: Tensor) -> Tensor:
        """As `MotionProblem.to_parameters`."""
        return self._from_field(self._from_motion(v_motion))

    def misfits(self, fields: Sequence[Tensor], pictures: np.ndarray) -> np.ndarray:
        """As `MotionProblem.misfits`."""
        total = np.zeros(len(fields))
        for k, (view, picture) in enumerate(zip(self.views, pictures, strict=True)):
            shown = self._there(picture)
            left = [(view.jvp(f) - shown).double() for f in fields]
            total += [float((d * self._weighted(k, d)).sum()) for d in left]
        return total

    def _weighted(self, k: int, picture: Tensor) -> Tensor:
        return picture if self.weights is None else picture * self.weights[k]

    def _there(self, picture: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(picture)).to(self.device)
