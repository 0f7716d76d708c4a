"""The motion stage's problem on a torch device: the same Jacobian, as a list of what meets where.

gsplat has no forward mode, and its cut-off of small alphas is compiled in at 1/255, which makes faint Gaussians
answer too weakly (`linear.py`); a difference of two renders would not be the transpose of its backward pass. But
the problem is linearised at rest once: every meeting of a pixel and a Gaussian has one weight (what the Gaussian's
colour does there) and one slope (what its exponent does), which stay the same through all iterations. The CPU
kernels project and sort each view once; the meetings are listed on the device, and from then on nothing is
rendered and nothing leaves the device but the three sums of a step of conjugate gradients.

Weights and slopes are kept in float16 on CUDA, sums are taken in float32: `push` and `pull` read the same rounded
numbers, so the operator stays symmetric, and 5e-4 on single entries is far below the noise of the images. A
meeting takes 16 bytes then.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from tg4mm.errors import Tg4mmError
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.linear import DOF
from tg4mm.motion.meetings import DeviceView, device_view
from tg4mm.motion.neighbours import Neighbourhoods
from tg4mm.motion.problem import MotionProblem


def _sparse(matrix: csr_matrix, device: str) -> Tensor:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        arrays = (matrix.indptr, matrix.indices, matrix.data.astype(np.float32))
        start, column, value = (torch.from_numpy(np.array(a)) for a in arrays)
        size = (matrix.shape[0], matrix.shape[1])
        return torch.sparse_csr_tensor(start, column, value, size, check_invariants=True).to(device)


@dataclass(frozen=True)
class _Operator:
    """A sparse matrix and its transpose, each stored by rows."""

    forward: Tensor
    back: Tensor

    @staticmethod
    def of(matrix: csr_matrix, device: str) -> _Operator:
        return _Operator(_sparse(matrix, device), _sparse(matrix.T.tocsr(), device))


class _DeviceNeighbourhoods:
    """`Neighbourhoods` on a device."""

    def __init__(self, around: Neighbourhoods, device: str) -> None:
        self._rotation = _Operator.of(around.rotation, device)
        self._differences = _Operator.of(around._differences, device)
        self._arms = torch.from_numpy(around._arms).to(device)
        self._owner = torch.from_numpy(np.asarray(around._owner, np.int64)).to(device)
        self._scale = around._scale

    def rotations(self, u: Tensor) -> Tensor:
        return (self._rotation.forward @ u.reshape(-1, 1)).reshape(-1, 3)

    def from_rotations(self, v: Tensor) -> Tensor:
        return (self._rotation.back @ v.reshape(-1, 1)).reshape(-1, 3)

    def stiffness(self, u: Tensor) -> Tensor:
        turned = torch.linalg.cross(self.rotations(u)[self._owner], self._arms)
        left = self._differences.forward @ u - turned
        turn = torch.linalg.cross(self._arms, left).reshape(len(u), -1, 3).sum(1)
        return (self._differences.back @ left - self.from_rotations(turn)) * self._scale


class DeviceProblem:
    """`MotionProblem` on a device: the same names, tensors in place of arrays."""

    def __init__(self, problem: MotionProblem, device: str, storage: torch.dtype | None = None) -> None:
        """`storage` of weights and slopes: None for float16 on CUDA, float32 elsewhere.

        Raises Tg4mmError where the device's memory does not hold the views.
        """
        if storage is None:
            storage = torch.float16 if device == "cuda" else torch.float32
        self.device, self.scale = device, problem.scale
        self._take_parameters(problem)
        self.around = _DeviceNeighbourhoods(problem.around, device)
        self.views: list[DeviceView] = []
        try:
            for view in problem.views:
                self.views.append(device_view(view, device, storage))
        except torch.OutOfMemoryError:
            raise Tg4mmError(
                f"the motion stage needs more memory than device {device} has: it holds {len(self.views)} of "
                f"{len(problem.views)} views; --device cpu needs none of it and takes up the same run"
            ) from None

    def _take_parameters(self, problem: MotionProblem) -> None:
        self.config: MotionConfig = problem.config
        self.sampling = _Operator.of(problem.sampling, self.device)
        damping = np.reshape(problem.damping, (-1, 1)).astype(np.float32)
        self.damping = torch.from_numpy(damping).to(self.device)

    def posed_as(self, problem: MotionProblem) -> DeviceProblem:
        """The same views and neighbours with the parameters and weights of `problem`; shares their memory."""
        other = copy.copy(self)
        other._take_parameters(problem)
        return other

    def of_views(self, rows: np.ndarray) -> DeviceProblem:
        """As `MotionProblem.of_views`; shares all memory."""
        some = copy.copy(self)
        some.views = [self.views[i] for i in rows]
        some.scale = self.scale * len(rows) / len(self.views)
        return some

    def field(self, theta: Tensor) -> Tensor:
        """θ [P, 3] -> displacement and rotation [N, DOF] float32."""
        u = self.sampling.forward @ theta
        return torch.cat([u, self.around.rotations(u)], 1)

    def normal(self, theta: Tensor) -> Tensor:
        """The symmetric operator of the problem applied to θ [P, 3]."""
        motion = self.field(theta)
        v_motion = torch.zeros_like(motion)
        for view in self.views:
            view.pull(view.push(motion), v_motion)
        v_u = self._to_displacement(v_motion)
        v_u += self.scale * self.config.neighbours * self.around.stiffness(motion[:, :3].contiguous())
        return self.sampling.back @ v_u + self.scale * self.config.ridge * self.damping * theta

    def right_hand_side(self, pictures: np.ndarray) -> Tensor:
        """The transposed operator applied to component images [V, H, W, 3]: [P, 3]."""
        return self.to_parameters(self.seen(pictures))

    def seen(self, pictures: np.ndarray) -> Tensor:
        """As `MotionProblem.seen`."""
        v_motion = torch.zeros(self.sampling.forward.shape[0], DOF, device=self.device)
        for view, picture in zip(self.views, pictures, strict=True):
            view.pull(self._there(picture), v_motion)
        return self._to_displacement(v_motion)

    def to_parameters(self, v_u: Tensor) -> Tensor:
        """As `MotionProblem.to_parameters`."""
        return self.sampling.back @ v_u

    def misfits(self, fields: Sequence[Tensor], pictures: np.ndarray) -> np.ndarray:
        """As `MotionProblem.misfits`."""
        total = np.zeros(len(fields))
        for view, picture in zip(self.views, pictures, strict=True):
            shown = self._there(picture)
            total += [float(((view.push(f) - shown).double() ** 2).sum()) for f in fields]
        return total

    def _there(self, picture: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(picture)).to(self.device)

    def _to_displacement(self, v_motion: Tensor) -> Tensor:
        return v_motion[:, :3] + self.around.from_rotations(v_motion[:, 3:].contiguous())
