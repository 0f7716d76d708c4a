"""The motion problem on a torch device: the same Jacobian, as a list of pixel–Gaussian contributions.

gsplat has no forward mode, and its cut-off of small alphas is compiled in at 1/255, which makes faint Gaussians respond
too weakly (`jacobian/view.py`); a difference of two renders would not be the transpose of its backward pass. But the
problem is linearised at rest only once: every contribution of a Gaussian to a pixel has one weight (the effect of the
Gaussian's colour) and one slope (the effect of its exponent), which are constant over all iterations. The CPU kernels
project and sort each view once; the contributions are listed on the device. From then on nothing is rendered, and only
the sums of a step of conjugate gradients leave the device.

Weights and slopes are float16 on CUDA, sums are float32: both directions read the same rounded numbers, so the operator
stays symmetric, and 5e-4 on single entries is far below the noise of the images. A contribution takes 16 bytes.
"""

import copy
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ALPHA_MIN_LINEAR, ViewJacobian
from tg4mm.fit.motion.prior import ROWS, NeighbourGraph
from tg4mm.fit.motion.solver.cpu import CpuOperator
from tg4mm.fit.motion.solver.operator import Operator
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, CA, CB, CC, FEAT, MX, MY, OP, T_MIN, TILE
from tg4mm.fit.space.view import WHITE

_AT_ONCE = 1 << 22  # contributions, and candidates for one, worked on together: bounds the memory


@dataclass(frozen=True)
class DeviceViewJacobian:
    """`ViewJacobian` as M contributions of n visible Gaussians to the pixels of one view."""

    size: tuple[int, int]  # width, height
    rows: Tensor  # [n] int64, which Gaussians
    jacobian: Tensor  # [n, 8, DOF] float32, of `ViewJacobian`
    means: Tensor  # [n, 2] pixels
    conics: Tensor  # [n, 3]
    pixel: Tensor  # [M] int32, row-major
    gaussian: Tensor  # [M] int32, 0 … n − 1
    weight: Tensor  # [M] transmittance × alpha
    slope: Tensor  # [M, 3] derivative of the pixel over white by the exponent σ (alpha = o exp(−σ))

    def jvp(self, motion: Tensor) -> Tensor:
        """J m: [N, DOF] float32 -> change of the picture over white [H, W, 3]."""
        d = torch.einsum("ncd,nd->nc", self.jacobian, motion[self.rows])
        a, b, c = self.conics.unbind(1)
        # dσ = A dx² + B dx dy + C dy² + D dx + E dy, with (dx, dy) from the Gaussian's mean to the pixel
        linear = [-(a * d[:, 0] + b * d[:, 1]), -(b * d[:, 0] + c * d[:, 1])]
        table = torch.stack([d[:, 2] / 2, d[:, 3], d[:, 4] / 2, *linear, *d[:, 5:].unbind(1)], 1)
        width, height = self.size
        out = torch.zeros(height * width, 3, device=motion.device)
        for some in self._chunks():
            entries = table.index_select(0, self.gaussian[some])
            d_sigma = (entries[:, :5] * self._monomials(some)).sum(1, keepdim=True)
            change = self.weight[some].float()[:, None] * entries[:, 5:] + self.slope[some].float() * d_sigma
            out.index_add_(0, self.pixel[some], change)
        return out.reshape(height, width, 3)

    def vjp(self, picture: Tensor, v_motion: Tensor) -> None:
        """Add Jᵀ p of a picture [H, W, 3] to `v_motion` [N, DOF]."""
        flat = picture.reshape(-1, 3)
        sums = torch.zeros(len(self.rows), 8, device=picture.device)
        for some in self._chunks():
            v = flat.index_select(0, self.pixel[some])
            v_sigma = (self.slope[some].float() * v).sum(1, keepdim=True)
            entries = torch.cat([v_sigma * self._monomials(some), self.weight[some].float()[:, None] * v], 1)
            sums.index_add_(0, self.gaussian[some], entries)
        a, b, c = self.conics.unbind(1)
        dx, dy = sums[:, 3], sums[:, 4]
        means = [-(a * dx + b * dy), -(b * dx + c * dy)]
        v_splats = torch.stack(
            [*means, sums[:, 0] / 2, sums[:, 1], sums[:, 2] / 2, *sums[:, 5:].unbind(1)], 1
        )
        v_motion.index_add_(0, self.rows, torch.einsum("ncd,nc->nd", self.jacobian, v_splats))

    def _chunks(self) -> Iterator[slice]:
        return (slice(i, i + _AT_ONCE) for i in range(0, len(self.pixel), _AT_ONCE))

    def _monomials(self, some: slice) -> Tensor:
        """Return [m, 5] dx², dx dy, dy², dx, dy."""
        pixel, mean = self.pixel[some], self.means.index_select(0, self.gaussian[some])
        dx = pixel % self.size[0] + 0.5 - mean[:, 0]
        dy = pixel // self.size[0] + 0.5 - mean[:, 1]
        return torch.stack([dx * dx, dx * dy, dy * dy, dx, dy], 1)


def device_view_jacobian(view: ViewJacobian, device: str, storage: torch.dtype) -> DeviceViewJacobian:
    """`view` with its contributions listed on the device; weights and slopes of type `storage`."""
    order = view.bins.order[: view.bins.n_visible]
    rank = np.zeros(len(view.splats), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    splats = torch.from_numpy(view.splats[order]).to(device)
    pairs = torch.from_numpy(rank[view.bins.pair_gaussian]).to(device)
    height, width = view.transmittance.shape
    starts = np.asarray(view.bins.tile_start, np.int64)
    parts = [_no_contributions(device, storage)]
    for tiles in _tile_groups(starts):
        parts.append(
            _contributions(splats, pairs, torch.from_numpy(tiles).to(device), (width, height), storage)
        )
    pixel, gaussian, weight, slope = (torch.cat(columns) for columns in zip(*parts, strict=True))
    return DeviceViewJacobian(
        size=(width, height),
        rows=torch.from_numpy(order.astype(np.int64)).to(device),
        jacobian=torch.from_numpy(view.jacobian).to(device),
        means=splats[:, MX : MY + 1].contiguous(),
        conics=splats[:, CA : CC + 1].contiguous(),
        pixel=pixel,
        gaussian=gaussian,
        weight=weight,
        slope=slope,
    )


def _no_contributions(device: str, storage: torch.dtype) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    index = torch.zeros(0, dtype=torch.int32, device=device)
    return index, index, index.to(storage), index.new_zeros(0, 3).to(storage)


def _tile_groups(starts: np.ndarray) -> Iterator[np.ndarray]:
    """Tiles grouped by length of list, each group [tiles, 3] int64: tile, start and length (above 0) of its list."""
    lengths = np.diff(starts)
    order = np.argsort(-lengths, kind="stable")[: np.count_nonzero(lengths)]
    first = 0
    while first < len(order):
        some = order[first : first + max(_AT_ONCE // (int(lengths[order[first]]) * TILE * TILE), 1)]
        yield np.stack([some, starts[some], lengths[some]], 1)
        first += len(some)


def _contributions(
    splats: Tensor, pairs: Tensor, tiles: Tensor, size: tuple[int, int], storage: torch.dtype
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Pixel, Gaussian, weight and slope of every contribution in tiles [t, 3]: [3DGS] Eq. (3), differentiated.

    With behind_k = Σ_{i > k} w_i c_i + T_end · white, a pixel changes by alpha_k (behind_k / (1 − alpha_k) − T_k c_k)
    for a change of σ_k.
    """
    tile, start, length = tiles.unbind(1)
    place = torch.arange(int(length.max()), device=splats.device)
    there = place < length[:, None]
    g = pairs[torch.where(there, start[:, None] + place, 0)]
    x, y = _pixels(tile, size[0])
    alpha, free = _alphas(splats, g, there, x, y)
    through = torch.cumprod(1 - alpha, 1)
    on = through > T_MIN
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], 1)
    weight = torch.where(on, before * alpha, 0.0)
    end = torch.where(on, through, 1.0).amin(1, keepdim=True)
    slopes = []
    for channel in range(FEAT, FEAT + 3):
        colour = splats[:, channel][g][:, :, None]
        contribution = weight * colour
        behind = contribution.flip(1).cumsum(1).flip(1) - contribution + WHITE * end
        slopes.append(torch.where(free & on, alpha * (behind / (1 - alpha) - before * colour), 0.0))
    inside = ((x < size[0]) & (y < size[1]))[:, None]
    t, k, p = torch.nonzero((weight > 0) & inside, as_tuple=True)
    slope = torch.stack([s[t, k, p] for s in slopes], 1)
    pixel = y[t, p] * size[0] + x[t, p]
    return pixel.int(), g[t, k].int(), weight[t, k, p].to(storage), slope.to(storage)


def _pixels(tile: Tensor, width: int) -> tuple[Tensor, Tensor]:
    """Columns and rows [t, TILE²] of the pixels of tiles [t]."""
    n_x = -(-width // TILE)
    k = torch.arange(TILE * TILE, device=tile.device)
    return (tile % n_x)[:, None] * TILE + k % TILE, (tile // n_x)[:, None] * TILE + k // TILE


def _alphas(splats: Tensor, g: Tensor, there: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Alphas [t, L, TILE²] of Gaussians g [t, L] and whether they depend on σ (not where clamped to ALPHA_MAX)."""
    s = splats[g]
    mx, my, a, b, c, opacity = (s[..., column, None] for column in (MX, MY, CA, CB, CC, OP))
    dx, dy = x[:, None] + 0.5 - mx, y[:, None] + 0.5 - my
    sigma = ((a / 2 * dx + b * dy) * dx + c / 2 * dy * dy).clamp_min(0)
    raw = opacity * torch.exp(-sigma)
    seen = (raw >= ALPHA_MIN_LINEAR) & there[:, :, None]
    return torch.where(seen, raw.clamp_max(ALPHA_MAX), 0.0), raw < ALPHA_MAX


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
        self,
        views: Sequence[ViewJacobian],
        graph: NeighbourGraph,
        device: str,
        storage: torch.dtype | None = None,
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
        self.patch_blocks = torch.from_numpy(pre.patch_blocks).to(self.device)
        self.aggregates = _Transposable.of(pre.aggregates.matrix.tocsr(), self.device)
        self.regions = _Transposable.of(pre.aggregates.regions.tocsr(), self.device)
        self.levels = pre.levels
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
            v_motions = []
            for picture in shown:
                v_motion = torch.zeros(len(self.blocks), DOF, device=self.device)
                view.vjp(self._weighted(k, self._sent(picture)), v_motion)
                v_motions.append(v_motion)
            v_motions = self._unmixed(k, v_motions)
            out = [a + b for a, b in zip(out, v_motions, strict=True)] if out else v_motions
        return torch.stack([self._from_field(self._from_motion(v)) for v in self._supported(out)])

    def products(self, theta: Tensor, rows: Sequence[int] | None = None) -> Tensor:
        """`Operator.products`."""
        some = list(theta) if rows is None else [theta[r] for r in rows]
        x = [self._field(t) for t in some]
        motions = self._supported([self._motion(one) for one in x])
        v_motions = [torch.zeros_like(m) for m in motions]
        for k in range(len(self.views)):
            through = [self._through(k, m) for m in self._mixed(k, motions)]
            for v, one in zip(v_motions, self._unmixed(k, through), strict=True):
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

    def with_graph(self, graph: NeighbourGraph) -> "DeviceOperator":
        """`Operator.with_graph`."""
        other = copy.copy(self)
        try:
            other.stiffness = _sparse(graph.stiffness, self.device)
        except torch.OutOfMemoryError:
            raise _too_small(self.device, "it holds one matrix of the neighbours, not two") from None
        return other

    def _field(self, theta: Tensor) -> Tensor:
        fine, patches, regions = (theta[rows] for rows in self.levels)
        coarse = self.regions.forward @ (self.coarse_factor @ regions)
        on_patches = coarse + (self.patch_blocks @ patches.reshape(-1, ROWS, 3)).reshape(-1, 3)
        x = (self.blocks @ fine.reshape(-1, ROWS, 3)).reshape(-1, 3)
        return x + self.aggregates.forward @ on_patches

    def _from_field(self, v: Tensor) -> Tensor:
        on_patches = self.aggregates.back @ v
        fine, patches = (
            (blocks.mT @ on.reshape(-1, ROWS, 3)).reshape(-1, 3)
            for blocks, on in ((self.blocks, v), (self.patch_blocks, on_patches))
        )
        return torch.cat([fine, patches, self.coarse_factor.T @ (self.regions.back @ on_patches)])

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

    def _unmixed(self, k: int, v_motions: list[Tensor]) -> list[Tensor]:
        if self.mixing is None:
            return v_motions
        return list(torch.tensordot(self.mixing[k].T, torch.stack(v_motions), 1))

    def _weighted(self, k: int, picture: Tensor) -> Tensor:
        return picture if self.weights is None else picture * self.weights[k]

    def _sent(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(self.device)


def views_on(device: str, views: Sequence[ViewJacobian], graph: NeighbourGraph) -> DeviceViews | None:
    """The views on a torch device; None on the CPU, whose operator reads them where they lie."""
    return None if device == "cpu" else DeviceViews(views, graph, device)


def operator_on(views: DeviceViews | None, operator: CpuOperator) -> Operator:
    """The operator where its views lie, as `views_on` gave them."""
    return operator if views is None else DeviceOperator(operator, views)
