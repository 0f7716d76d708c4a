"""The CPU path as a torch autograd function around the numba kernels, for any number of cameras."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.fit.rasterize.buffers import Buffers
from tg4mm.fit.rasterize.kernels.binning import Bins, bin_splats, gather_sums
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import empty_splats, pack_camera, project_forward
from tg4mm.fit.rasterize.kernels.project_backward import project_backward


@dataclass(frozen=True)
class View:
    """The non-tensor arguments of one call. `degree` is the SH degree, -1 for plain channels."""

    width: int
    height: int
    near: float
    far: float
    eps2d: float
    degree: int
    with_depth: bool


@dataclass
class Projected:
    """Results of one view's forward pass, for meta and the backward pass."""

    splats: np.ndarray  # [N, SPLAT_WIDTH]
    bins: Bins
    v_splats: np.ndarray | None = None  # filled by the backward pass, sums as in layout.py; 0 where invisible


def _array(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy(), dtype=np.float32)


class RasterizeViews(torch.autograd.Function):
    """(means … opacities, features [N, K, D], viewmats, Ks) -> C images and C transmittances.

    Views follow each other, each on all threads; all of them add to the same gradient arrays. One array a view: memory
    above some 30 MB goes back to the system each time, and fetching it anew costs as much as blending.
    """

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        features: Tensor,
        viewmats: Tensor,
        Ks: Tensor,
        view: View,
        projected: list[Projected],
    ) -> tuple[Tensor, ...]:
        arrays = [_array(a) for a in (means, quats, scales, opacities, features)]
        poses = zip(_array(viewmats), _array(Ks), strict=True)
        cameras = [pack_camera(*pose, view.near, view.far, view.eps2d) for pose in poses]
        width, height = view.width, view.height
        images = [np.empty((height, width, FEATURES), np.float32) for _ in cameras]
        transmittances = [np.empty((height, width), np.float32) for _ in cameras]
        for camera, image, transmittance in zip(cameras, images, transmittances, strict=True):
            splats = empty_splats(len(means))
            project_forward(*arrays, view.degree, view.with_depth, camera, width, height, splats)
            bins = bin_splats(splats, width, height)
            blend_forward(
                splats, bins.tile_start, bins.pair_gaussian, width, height, image, transmittance,
                reached=bins.reached,
            )  # fmt: skip
            projected.append(Projected(splats, bins))
        ctx.saved = arrays, cameras, view, projected, images, transmittances
        return tuple(torch.from_numpy(a) for a in (*images, *transmittances))

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        arrays, cameras, view, projected, *pictures = ctx.saved
        v_pictures = (gradients[: len(cameras)], gradients[len(cameras) :])
        grads = [np.zeros_like(a) for a in arrays]
        with_pose = bool(ctx.needs_input_grad[5])
        v_pose = np.empty((len(arrays[0]) if with_pose else 0, 12), np.float32)
        v_viewmats = torch.zeros(len(cameras), 4, 4) if with_pose else None
        buffers = Buffers()
        for c, (camera, record) in enumerate(zip(cameras, projected, strict=True)):
            around = (pictures[0][c], pictures[1][c], _array(v_pictures[0][c]), _array(v_pictures[1][c]))
            record.v_splats = _gradient_by_splats(record, view, around, buffers)
            means, quats, scales, _, features = arrays
            v_pose[:] = 0
            project_backward(
                means, quats, scales, features, view.degree, view.with_depth, camera, view.width, view.height,
                record.splats, record.v_splats, True, *grads, v_pose, with_pose,
            )  # fmt: skip
            if v_viewmats is not None:
                total = torch.from_numpy(v_pose.sum(0, dtype=np.float64).astype(np.float32))
                v_viewmats[c, :3, :3], v_viewmats[c, :3, 3] = total[:9].reshape(3, 3), total[9:]
        return (*(torch.from_numpy(g) for g in grads), v_viewmats, None, None, None)


def _gradient_by_splats(
    record: Projected, view: View, pictures: tuple[np.ndarray, ...], buffers: Buffers
) -> np.ndarray:
    """[N, SPLAT_WIDTH]; pictures: image and transmittance, and the gradients by them."""
    image, transmittance, v_image, v_transmittance = pictures
    bins = record.bins
    pair_sums = buffers.take("pair_sums", (len(bins.pair_gaussian), SPLAT_WIDTH))
    blend_backward(
        record.splats, bins.tile_start, bins.pair_gaussian, view.width, view.height,
        image, transmittance, v_image, v_transmittance, pair_sums, reached=bins.reached,
    )  # fmt: skip
    v_splats = empty_splats(len(record.splats))
    v_splats[:] = 0
    gather_sums(bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot, pair_sums, v_splats)
    return v_splats


def rasterize_cpu(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    features: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    view: View,
) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...], list[Projected]]:
    """C views without background: images [H, W, FEATURES], transmittances [H, W], and what was projected."""
    projected: list[Projected] = []
    pictures = RasterizeViews.apply(means, quats, scales, opacities, features, viewmats, Ks, view, projected)
    return pictures[: len(projected)], pictures[len(projected) :], projected
