"""The motion problem on a torch device: the same Jacobian, as a list of pixel–Gaussian contributions.

gsplat has no forward mode, and its cut-off of small alphas is compiled in at 1/255, which makes faint Gaussians
respond too weakly (`jacobian/view.py`); a difference of two renders would not be the transpose of its backward pass.
But the problem is linearised at rest once: every contribution of a Gaussian to a pixel has one weight (what
the Gaussian's colour does there) and one slope (what its exponent does), which stay the same through all
iterations. The CPU kernels project and sort each view once; the contributions are listed on the device, and from
then on nothing is rendered and nothing leaves the device but the sums of a step of conjugate gradients.

Weights and slopes are kept in float16 on CUDA, sums are taken in float32: both directions read the same rounded
numbers, so the operator stays symmetric, and 5e-4 on single entries is far below the noise of the images. A
contribution takes 16 bytes then.
"""

import copy
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.motion.jacobian.contributions import DeviceViewJacobian, device_view_jacobian
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian
from tg4mm.fit.motion.prior.graph import Graph
from tg4mm.fit.motion.prior.tgv import ROWS
from tg4mm.fit.motion.solver.cpu import CpuOperator
from tg4mm.fit.motion.solver.operator import Operator


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
        "--device cpu continues the run on the processor"
    )


@dataclass(frozen=True)
class _Transposable:
    """A sparse matrix and its transpose, each stored by rows."""

    forward: Tensor
    back: Tensor

    @staticmethod
    def of(matrix: csr_matrix, device: str) -> "_Transposable":
        return _Transposable(_sparse(matrix, device), _sparse(matrix.T.tocsr(), device))


class DeviceViews:
    """Views' contributions and the graph's constants on a device, shared by all operators of one fit."""

    def __init__(
        self, views: Sequence[ViewJacobian], graph: Graph, device: str, storage: torch.dtype | None = None
    ) -> None:
        """`storage` of weights and slopes: None for float16 on CUDA, float32 elsewhere.

        Raises Tg4mmError where the device's memory does not hold the views.
        """
        if storage is None:
            storage = torch.float16 if device == "cuda" else torch.float32
        self.device = device
        self.gradient_to_rotation = torch.from_numpy(graph.gradient_to_rotation).to(device)
        self.by_view: dict[int, DeviceViewJacobian] = {}
        try:
            for view in views:
                self.by_view[id(view)] = device_view_jacobian(view, device, storage)
        except torch.OutOfMemoryError:
            raise _too_small(device, f"it holds {len(self.by_view)} of {len(views)} views") from None


class DeviceOperator:
    """`Operator` on tensors, made of a `CpuOperator` whose views lie on the device."""

    def __init__(self, operator: CpuOperator, there: DeviceViews) -> None:
        self.there, self.device = there, there.device
        self.smoothness_weight, self.ridge = operator.smoothness_weight, operator.ridge
        self.scale, self.is_coupled = operator.scale, operator.is_coupled
        self.views = [there.by_view[id(view)] for view in operator.views]
        pre = operator.preconditioner
        self.blocks = torch.from_numpy(pre.blocks).to(self.device)
        self.aggregates = _Transposable.of(pre.aggregates.matrix.tocsr(), self.device)
        self.coarse_factor = torch.from_numpy(pre.coarse_factor).to(self.device)
        self.stiffness = _sparse(operator.graph.stiffness, self.device)
        self.weights = None if operator.weights is None else self._sent(operator.weights[..., None])
        self.projections = operator.projections
        self.adjoint_columns = None
        if operator.projections is not None:
            self.adjoint_columns = [self._sent(p.adjoint_columns).flatten(1) for p in operator.projections]
        self.mixing = None if operator.mixing is None else [self._sent(m) for m in operator.mixing]
        self.support = None if operator.support is None else self._sent(operator.support[..., None])

    def right_hand_sides(self, pictures: Iterable[np.ndarray]) -> Tensor:
        """`Operator.right_hand_sides`."""
        out: list[Tensor] = []
        for k, (view, shown) in enumerate(zip(self.views, pictures, strict=True)):
            if self.projections is not None:
                shown = self.projections[k].out_of(shown)
                self.projections[k].release()
            own = []
            for picture in shown:
                v_motion = torch.zeros(len(self.blocks), DOF, device=self.device)
                view.vjp(self._weighted(k, self._sent(picture)), v_motion)
                own.append(v_motion)
            own = self._unmixed(k, own)
            out = [a + b for a, b in zip(out, own, strict=True)] if out else own
        return torch.stack([self._from_field(self._from_motion(v)) for v in self._supported(out)])

    def products(self, theta: Tensor, rows: Sequence[int] | None = None) -> Tensor:
        """`Operator.products`."""
        some = list(theta) if rows is None else [theta[r] for r in rows]
        x = [self._field(t) for t in some]
        motions = self._supported([self._motion(one) for one in x])
        v_motions = [torch.zeros_like(m) for m in motions]
        for k in range(len(self.views)):
            own = [self._through(k, m) for m in self._mixed(k, motions)]
            for v, one in zip(v_motions, self._unmixed(k, own), strict=True):
                v += one
        pairs = zip(self._supported(v_motions), x, strict=True)
        sums = [self._from_motion(v) + self._prior(one) for v, one in pairs]
        return torch.stack([self._from_field(v) for v in sums])

    def _through(self, k: int, motion: Tensor) -> Tensor:
        """Jᵀ W (1 − Q Qᵀ W) J of one motion [N, 6]."""
        out = torch.zeros_like(motion)
        self.views[k].vjp(self._weighted(k, self.views[k].jvp(motion)), out)
        if self.adjoint_columns is not None:
            columns = self.adjoint_columns[k]
            out -= (columns.T @ (columns @ motion.flatten())).reshape(out.shape)
        return out

    def fields(self, theta: Tensor) -> np.ndarray:
        """`Operator.fields`."""
        motions = self._supported([self._motion(self._field(t)) for t in theta])
        return torch.stack(motions).cpu().numpy()

    def gradient_fields(self, theta: Tensor) -> np.ndarray:
        """`Operator.gradient_fields`."""
        return torch.stack([self._field(t) for t in theta]).cpu().numpy()

    def prior_products(self, x: np.ndarray) -> Tensor:
        """`Operator.prior_products`."""
        return torch.stack([self._from_field(self._prior(self._sent(one))) for one in x])

    def misfit(self, fields: np.ndarray, pictures: Iterable[np.ndarray]) -> float:
        """`Operator.misfit`."""
        total = 0.0
        motions = [self._sent(f) for f in fields]
        for k, (view, shown) in enumerate(zip(self.views, pictures, strict=True)):
            if self.projections is not None:
                shown = self.projections[k].out_of(shown)
                self.projections[k].release()
            for motion, picture in zip(self._mixed(k, motions), shown, strict=True):
                residual = (view.jvp(motion) - self._sent(picture)).double()
                total += float((residual * self._weighted(k, residual)).sum())
                if self.adjoint_columns is not None:
                    total -= float((self.adjoint_columns[k] @ motion.flatten()).double().square().sum())
        return total

    def with_graph(self, graph: Graph) -> "DeviceOperator":
        """`Operator.with_graph`."""
        other = copy.copy(self)
        try:
            other.stiffness = _sparse(graph.stiffness, self.device)
        except torch.OutOfMemoryError:
            raise _too_small(self.device, "it holds one matrix of the neighbours, not two") from None
        return other

    def _field(self, theta: Tensor) -> Tensor:
        fine = ROWS * len(self.blocks)
        x = (self.blocks @ theta[:fine].reshape(-1, ROWS, 3)).reshape(-1, 3)
        return x + self.aggregates.forward @ (self.coarse_factor @ theta[fine:])

    def _from_field(self, v: Tensor) -> Tensor:
        fine = (self.blocks.mT @ v.reshape(-1, ROWS, 3)).reshape(-1, 3)
        return torch.cat([fine, self.coarse_factor.T @ (self.aggregates.back @ v)])

    def _motion(self, x: Tensor) -> Tensor:
        f = x.reshape(-1, ROWS, 3)
        return torch.cat([f[:, 0], (f[:, 1:].reshape(-1, 1, 9) @ self.there.gradient_to_rotation)[:, 0]], 1)

    def _from_motion(self, v_motion: Tensor) -> Tensor:
        gradient = (self.there.gradient_to_rotation @ v_motion[:, 3:, None]).reshape(-1, 3, 3)
        return torch.cat([v_motion[:, None, :3], gradient], 1).reshape(-1, 3)

    def _prior(self, x: Tensor) -> Tensor:
        return self.scale * (self.smoothness_weight * (self.stiffness @ x) + self.ridge * x)

    def _supported(self, motions: list[Tensor]) -> list[Tensor]:
        """Motions [N, 6] of the fields, 0 outside their support."""
        if self.support is None:
            return motions
        return [m * s for m, s in zip(motions, self.support, strict=True)]

    def _mixed(self, k: int, motions: list[Tensor]) -> list[Tensor]:
        if self.mixing is None:
            return motions
        return list(torch.tensordot(self.mixing[k], torch.stack(motions), 1))

    def _unmixed(self, k: int, own: list[Tensor]) -> list[Tensor]:
        if self.mixing is None:
            return own
        return list(torch.tensordot(self.mixing[k].T, torch.stack(own), 1))

    def _weighted(self, k: int, picture: Tensor) -> Tensor:
        return picture if self.weights is None else picture * self.weights[k]

    def _sent(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(self.device)


def views_on(device: str, views: Sequence[ViewJacobian], graph: Graph) -> DeviceViews | None:
    """The views on a torch device; None on the CPU, whose operator reads them where they lie."""
    return None if device == "cpu" else DeviceViews(views, graph, device)


def operator_on(views: DeviceViews | None, operator: CpuOperator) -> Operator:
    """The operator where its views lie, as `views_on` gave them."""
    return operator if views is None else DeviceOperator(operator, views)
