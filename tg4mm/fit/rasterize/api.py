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
from tg4mm.fit.rasterize.buffers import Buffers
from tg4mm.fit.rasterize.kernels.binning import Bins, bin_splats, gather_sums
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import empty_splats, pack_camera, project_forward
from tg4mm.fit.rasterize.kernels.project_backward import project_backward

_INSTALL = install("cuda")
RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")


def require_gsplat() -> None:
    """Load gsplat's kernels, so that what is missing is said before any work; the first time ever that may compile.

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


def rasterize_cuda(*args: Any, **kwargs: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """`tg4mm.fit.rasterize.rasterization` of CUDA tensors, checked already. Raises Tg4mmError without gsplat."""
    try:
        from gsplat import rasterization
    except ImportError as error:
        raise Tg4mmError(f"device cuda needs gsplat: {_INSTALL}") from error
    # Packed tensors save memory where cameras see little of the scene; ours see nearly all of it.
    return rasterization(*args, packed=False, **kwargs)


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


def _check_shapes(tensors: dict[str, tuple[Tensor, tuple[int | None, ...]]]) -> None:
    for name, (tensor, shape) in tensors.items():
        actual = tuple(tensor.shape)
        if len(actual) != len(shape) or any(
            want not in (None, got) for want, got in zip(shape, actual, strict=True)
        ):
            wanted = tuple("any" if s is None else s for s in shape)
            raise ValueError(f"{name} has shape {actual}, expected {wanted}")


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
    render_mode: str = "RGB",
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Render Gaussians from C cameras ([3DGS] Eqs. (1) to (3)). Names and meaning of the arguments are gsplat's.

    Gradients reach every tensor but Ks.

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
        near_plane: scene units; what is nearer is not drawn.
        far_plane: scene units; what is farther is not drawn.
        eps2d: square pixels added to the projected variance, the low-pass.
        sh_degree: 0 … 3; `None`: `colors` are channels.
        backgrounds: [C, D], for colour channels only; `None`: black.
        render_mode: "RGB", "D" (Σ w·z), "ED" (that divided by alpha), "RGB+D" or "RGB+ED".

    Returns:
        Renders [C, H, W, X] with X channels of colour, depth or both; alphas [C, H, W, 1]; and a dictionary with
        `projected` (CPU only: one record for each camera and for each pass over four channels).

    Raises:
        ValueError: a shape is wrong; the message shows both shapes.
        Tg4mmError: the tensors are on CUDA and gsplat is not installed.
    """
    n, c = means.shape[0], viewmats.shape[0]
    shapes: dict[str, tuple[Tensor, tuple[int | None, ...]]] = {
        "means": (means, (n, 3)),
        "quats": (quats, (n, 4)),
        "scales": (scales, (n, 3)),
        "opacities": (opacities, (n,)),
        "colors": (colors, (n, None, 3) if sh_degree is not None else (n, None)),
        "viewmats": (viewmats, (c, 4, 4)),
        "Ks": (Ks, (c, 3, 3)),
    }
    channels = 3 if sh_degree is not None else colors.shape[-1]
    if backgrounds is not None:
        shapes["backgrounds"] = (backgrounds, (c, channels))
    _check_shapes(shapes)
    if render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode is {render_mode!r}, expected one of {', '.join(RENDER_MODES)}")
    if sh_degree is not None and not 0 <= sh_degree <= 3:
        raise ValueError(f"sh_degree is {sh_degree}, expected 0 to 3")
    if sh_degree is not None and colors.shape[1] < (sh_degree + 1) ** 2:
        needed = (sh_degree + 1) ** 2
        raise ValueError(f"colors has {colors.shape[1]} SH coefficients, degree {sh_degree} needs {needed}")
    if width < 1 or height < 1:
        raise ValueError(f"image size is {width}×{height}, expected at least 1×1")
    if means.is_cuda:
        return rasterize_cuda(
            means, quats, scales, opacities, colors, viewmats, Ks, width, height,
            near_plane=near_plane, far_plane=far_plane, eps2d=eps2d,
            sh_degree=sh_degree, backgrounds=backgrounds, render_mode=render_mode,
        )  # fmt: skip
    renders, alphas, records = _cpu_views(
        (means, quats, scales, opacities), colors, viewmats, Ks, (width, height, near_plane, far_plane, eps2d),
        sh_degree, backgrounds, render_mode,
    )  # fmt: skip
    return renders, alphas, {"projected": records, "width": width, "height": height}


def _cpu_views(
    geometry: tuple[Tensor, Tensor, Tensor, Tensor],
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    frame: tuple[int, int, float, float, float],
    sh_degree: int | None,
    backgrounds: Tensor | None,
    render_mode: str,
) -> tuple[Tensor, Tensor, list[Any]]:
    """All cameras on the CPU. Channels beyond what one pass blends take further passes."""
    wants_colour, wants_depth = "RGB" in render_mode, render_mode != "RGB"
    # The depth channel is the last of a pass, so a pass with depth has one colour channel less.
    if not wants_colour:
        passes = [colors.new_zeros(len(colors), 1, 1)]
    elif sh_degree is not None:
        passes = [colors]
    else:
        step = FEATURES - 1 if wants_depth else FEATURES
        passes = [part[:, None] for part in colors.split(step, dim=1)]
    sh = sh_degree if sh_degree is not None and wants_colour else -1
    view = View(*frame, sh, wants_depth)
    images: list[list[Tensor]] = [[] for _ in viewmats]
    transmittances: tuple[Tensor, ...] = ()
    records: list[Any] = []
    for features in passes:
        pictures, transmittances, projected = rasterize_cpu(*geometry, features, viewmats, Ks, view)
        for of_view, image in zip(images, pictures, strict=True):
            of_view.append(image)
        records += projected
    widths = [part.shape[-1] for part in passes] if wants_colour else []
    renders = []
    for i, transmittance in enumerate(transmittances):
        background = None if backgrounds is None else backgrounds[i]
        renders.append(_composed(images[i], transmittance, widths, background, render_mode))
    return torch.stack(renders), torch.stack([1 - t[..., None] for t in transmittances]), records


def _composed(
    images: list[Tensor],
    transmittance: Tensor,
    widths: list[int],
    background: Tensor | None,
    render_mode: str,
) -> Tensor:
    """One camera's passes [H, W, FEATURES], of which `widths` channels are colour, as the mode wants them."""
    parts = []
    if widths:
        shown = [image[..., :width] for image, width in zip(images, widths, strict=True)]
        colour = shown[0] if len(shown) == 1 else torch.cat(shown, -1)
        parts.append(colour if background is None else colour + transmittance[..., None] * background)
    if render_mode != "RGB":
        depth, alpha = images[-1][..., FEATURES - 1 :], 1 - transmittance[..., None]
        parts.append(depth / alpha.clamp_min(1e-10) if "ED" in render_mode else depth)
    return parts[0] if len(parts) == 1 else torch.cat(parts, -1)
