"""`rasterization`: gsplat's call, dispatched by device. CUDA goes to gsplat, CPU to our kernels."""

from typing import Any

import torch
from torch import Tensor

from tg4mm.fit.rasterize.kernels.layout import FEATURES

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")


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
        from tg4mm.fit.rasterize.cuda import rasterize_cuda

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
    from tg4mm.fit.rasterize.cpu import View, rasterize_cpu

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
