"""`rasterization`: gsplat's call, dispatched by device: CUDA goes to gsplat, CPU to the numba kernels through autograd.

What gsplat's kernels do otherwise than ours: docs/conventions.md, "Devices".
"""

import importlib
import inspect
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.extras import install
from tg4mm.core.memory import Buffers
from tg4mm.fit.rasterize.kernels.binning import Bins, bin_splats, gather_sums
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import empty_splats, pack_camera, project_forward
from tg4mm.fit.rasterize.kernels.project_backward import project_backward

_INSTALL = install("cuda")


def require_gsplat() -> None:
    """Load gsplat's kernels, so that an error appears before any work; the first call on a machine may compile them.

    Raises Tg4mmError if gsplat is absent, too old, too new, or without kernels for this machine.
    """
    try:
        import gsplat
    except ImportError as error:
        raise Tg4mmError(f"device cuda needs gsplat: {_INSTALL}") from error
    if "opacities" not in inspect.signature(gsplat.fully_fused_projection).parameters:
        # it cut every Gaussian at three standard deviations, where an opaque one still has an alpha of 0.011
        raise Tg4mmError(f"gsplat {gsplat.__version__} is too old, tg4mm needs 1.5: {_INSTALL}")
    if "dirs" not in inspect.signature(gsplat.spherical_harmonics).parameters:
        # 1.6 takes means and viewmats instead, and lowered the largest alpha from 0.999 to 0.99: other pictures
        raise Tg4mmError(f"gsplat {gsplat.__version__} is too new, tg4mm needs 1.5: {_INSTALL}")
    try:
        kernels = importlib.import_module("gsplat.cuda._backend")._C
    except Exception as error:  # the compiler's, ninja's or the loader's; none has a type of its own
        # after an OSError of the build gsplat tries to load what was not built, and fails once more
        first = error.__context__ if isinstance(error.__context__, OSError) else error
        reason = (str(first).strip() or type(first).__name__).splitlines()[0]
        raise Tg4mmError(f"gsplat's CUDA kernels do not load: {reason}") from error
    if kernels is None:
        raise Tg4mmError(
            "gsplat is installed without CUDA kernels and finds no nvcc to build them: install the CUDA toolkit, "
            "or a wheel built for this torch (https://docs.gsplat.studio/whl)"
        )


@dataclass(frozen=True)
class View:
    """Size and planes of one call; `degree` is the SH degree, -1 for plain channels."""

    width: int
    height: int
    near: float
    far: float
    eps2d: float
    degree: int


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

    Views follow each other, each on all threads, and add to the same gradient arrays. Every view has its own array:
    memory above some 30 MB is returned to the system each time, and fetching it again costs as much as blending.
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
            project_forward(*arrays, view.degree, camera, width, height, splats)
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
        means, quats, scales, _, features = arrays
        buffers = Buffers()
        for c, (camera, record) in enumerate(zip(cameras, projected, strict=True)):
            around = (pictures[0][c], pictures[1][c], _array(v_pictures[0][c]), _array(v_pictures[1][c]))
            record.v_splats = _gradient_by_splats(record, view, around, buffers)
            project_backward(
                means, quats, scales, features, view.degree, camera, view.width, view.height, record.splats,
                record.v_splats, True, *grads,
            )  # fmt: skip
        return (*(torch.from_numpy(g) for g in grads), None, None, None, None)


def _gradient_by_splats(
    record: Projected, view: View, pictures: tuple[np.ndarray, ...], buffers: Buffers
) -> np.ndarray:
    """Return [N, SPLAT_WIDTH]; pictures: image and transmittance, and the gradients by them."""
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


def rasterization(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    backgrounds: Tensor | None = None,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Render Gaussians from C cameras ([3DGS] Eqs. (1) to (3)). Names and meaning of the arguments are gsplat's.

    Gradients reach the Gaussians' tensors and `backgrounds`; on CUDA, the cameras too.

    Args:
        means: [N, 3] scene units.
        quats: [N, 4] wxyz, of any length but zero.
        scales: [N, 3] linear standard deviations, scene units.
        opacities: [N] in 0..1.
        colors: [N, K, 3] coefficients of spherical harmonics with `sh_degree`, else [N, D] channels.
        viewmats: [C, 4, 4] world-to-camera, OpenCV axes.
        Ks: [C, 3, 3] pixels, pixel centres at +0.5.
        width: pixels.
        height: pixels.
        near_plane: scene units; nearer Gaussians are not drawn.
        far_plane: scene units; farther Gaussians are not drawn.
        eps2d: low-pass, square pixels added to the projected variance.
        sh_degree: 0 … 3; `None`: `colors` are channels.
        backgrounds: [C, D] colours behind the Gaussians; `None`: black.

    Returns:
        Renders [C, H, W, D]; alphas [C, H, W, 1]; and a dictionary with `projected` (CPU only: one record for each
        camera and for each pass over four channels).

    Raises:
        ValueError: a shape is wrong; the message shows both shapes.
        Tg4mmError: the tensors are on CUDA and gsplat is not installed.
    """
    n, c = means.shape[0], viewmats.shape[0]
    channels = 3 if sh_degree is not None else colors.shape[-1]
    shapes: dict[str, tuple[Tensor | None, tuple[int | None, ...]]] = {
        "means": (means, (n, 3)),
        "quats": (quats, (n, 4)),
        "scales": (scales, (n, 3)),
        "opacities": (opacities, (n,)),
        "colors": (colors, (n, None, 3) if sh_degree is not None else (n, None)),
        "viewmats": (viewmats, (c, 4, 4)),
        "Ks": (Ks, (c, 3, 3)),
        "backgrounds": (backgrounds, (c, channels)),
    }
    for name, (tensor, shape) in shapes.items():
        actual = None if tensor is None else tuple(tensor.shape)
        if actual is not None and (
            len(actual) != len(shape) or any(s not in (None, a) for s, a in zip(shape, actual, strict=True))
        ):
            raise ValueError(
                f"{name} has shape {actual}, expected {tuple('any' if s is None else s for s in shape)}"
            )
    if sh_degree is not None and not 0 <= sh_degree <= 3:
        raise ValueError(f"sh_degree is {sh_degree}, expected 0 to 3")
    if sh_degree is not None and colors.shape[1] < (sh_degree + 1) ** 2:
        needed = (sh_degree + 1) ** 2
        raise ValueError(f"colors has {colors.shape[1]} SH coefficients, degree {sh_degree} needs {needed}")
    if width < 1 or height < 1:
        raise ValueError(f"image size is {width}×{height}, expected at least 1×1")
    if means.is_cuda:
        try:
            from gsplat import rasterization as of_gsplat
        except ImportError as error:
            raise Tg4mmError(f"device cuda needs gsplat: {_INSTALL}") from error
        # Packed tensors save memory where cameras see little of the scene; ours see nearly all of it.
        return of_gsplat(
            means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=near_plane,
            far_plane=far_plane, eps2d=eps2d, sh_degree=sh_degree, backgrounds=backgrounds, packed=False,
        )  # fmt: skip
    # channels beyond what one pass blends take further passes
    passes = [colors] if sh_degree is not None else [part[:, None] for part in colors.split(FEATURES, dim=1)]
    view = View(width, height, near_plane, far_plane, eps2d, -1 if sh_degree is None else sh_degree)
    images: list[tuple[Tensor, ...]] = []
    transmittances: tuple[Tensor, ...] = ()
    records: list[Projected] = []
    for features in passes:
        pictures, transmittances, projected = rasterize_cpu(
            means, quats, scales, opacities, features, viewmats, Ks, view
        )
        images.append(tuple(p[..., : features.shape[-1]] for p in pictures))
        records += projected
    views = [parts[0] if len(parts) == 1 else torch.cat(parts, -1) for parts in zip(*images, strict=True)]
    renders, light = (v[0][None] if len(v) == 1 else torch.stack(list(v)) for v in (views, transmittances))
    light = light[..., None]
    if backgrounds is not None:
        renders = torch.addcmul(renders, light, backgrounds[:, None, None])
    return renders, 1 - light, {"projected": records, "width": width, "height": height}
