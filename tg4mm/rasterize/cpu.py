"""The CPU path as a torch autograd function around the numba kernels: one view a call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.rasterize.kernels.binning import Bins, bin_splats, gather_gradient
from tg4mm.rasterize.kernels.blend import blend_backward, blend_forward
from tg4mm.rasterize.kernels.layout import FEAT, FEATURES
from tg4mm.rasterize.kernels.project import empty_splats, pack_camera, project_backward, project_forward


@dataclass(frozen=True)
class View:
    """What one call needs besides tensors. `degree` is the SH degree, -1 for plain channels."""

    width: int
    height: int
    near: float
    far: float
    eps2d: float
    degree: int
    with_depth: bool


@dataclass
class Projected:
    """What the forward pass found out about one view: for meta, and for the backward pass."""

    splats: np.ndarray  # [N, SPLAT_WIDTH]
    bins: Bins
    v_splats: np.ndarray | None = None  # filled by the backward pass; rows of invisible Gaussians are zero


def _array(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy(), dtype=np.float32)


class RasterizeView(torch.autograd.Function):
    """(means … opacities, features [N, K, D], viewmat, K) -> [H, W, FEATURES], transmittance [H, W]."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        features: Tensor,
        viewmat: Tensor,
        K: Tensor,
        view: View,
        projected: list[Projected],
    ) -> tuple[Tensor, Tensor]:
        arrays = [_array(a) for a in (means, quats, scales, opacities, features)]
        camera = pack_camera(_array(viewmat), _array(K), view.near, view.far, view.eps2d)
        splats = empty_splats(len(means))
        project_forward(
            arrays[0], arrays[1], arrays[2], arrays[3], arrays[4], view.degree, view.with_depth, camera,
            view.width, view.height, splats,
        )  # fmt: skip
        bins = bin_splats(splats, view.width, view.height)
        image = np.empty((view.height, view.width, FEATURES), np.float32)
        transmittance = np.empty((view.height, view.width), np.float32)
        blend_forward(
            splats, bins.tile_start, bins.pair_gaussian, view.width, view.height, image, transmittance,
            reached=bins.reached,
        )  # fmt: skip
        record = Projected(splats, bins)
        projected.append(record)
        ctx.saved = arrays, camera, view, record, image, transmittance
        return torch.from_numpy(image), torch.from_numpy(transmittance)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (means, quats, scales, opacities, features), camera, view, record, image, transmittance = ctx.saved
        bins, (v_image, v_transmittance) = record.bins, gradients
        v_pairs = np.empty((len(bins.pair_gaussian), FEAT + FEATURES), np.float32)
        blend_backward(
            record.splats, bins.tile_start, bins.pair_gaussian, view.width, view.height,
            image, transmittance, _array(v_image), _array(v_transmittance), v_pairs,
            reached=bins.reached,
        )  # fmt: skip
        v_splats = np.zeros_like(record.splats)
        gather_gradient(bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot, v_pairs, v_splats)
        record.v_splats = v_splats
        grads = [np.zeros_like(a) for a in (means, quats, scales, opacities, features)]
        with_pose = bool(ctx.needs_input_grad[5])
        v_pose = np.zeros((len(means) if with_pose else 0, 12), np.float32)
        project_backward(
            means, quats, scales, features, view.degree, view.with_depth, camera, view.width, view.height,
            record.splats, v_splats, grads[0], grads[1], grads[2], grads[3], grads[4], v_pose, with_pose,
        )  # fmt: skip
        v_viewmat = None
        if with_pose:
            total = v_pose.sum(0, dtype=np.float64).astype(np.float32)
            v_viewmat = torch.zeros(4, 4)
            v_viewmat[:3, :3] = torch.from_numpy(total[:9].reshape(3, 3))
            v_viewmat[:3, 3] = torch.from_numpy(total[9:])
        tensors = [torch.from_numpy(g) for g in grads]
        return (*tensors, v_viewmat, None, None, None)


def rasterize_cpu(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    features: Tensor,
    viewmat: Tensor,
    K: Tensor,
    view: View,
) -> tuple[Tensor, Tensor, Projected]:
    """One view without background: image [H, W, FEATURES], transmittance [H, W], and what was projected."""
    projected: list[Projected] = []
    image, transmittance = RasterizeView.apply(
        means, quats, scales, opacities, features, viewmat, K, view, projected
    )
    return image, transmittance, projected[0]
