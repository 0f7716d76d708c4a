"""One training view: the picture, and each Gaussian's share of its error after the backward pass.

The share of Gaussian i is Σ over pixels of blending weight × error: the gradient of Σ error · (a channel that is zero
on every Gaussian) by that channel. The CPU kernels blend four channels anyway, so it costs nothing there.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from tg4mm.fit.gaussians import Gaussians

WHITE = 1.0
NEAR, FAR, EPS2D = 0.01, 1e10, 0.3  # gsplat's defaults, of a scene that is DISTANCE away
DISTANCE = 4.0  # scene units, NeRF-synthetic's from the cameras to what they look at
_LOOKED_AT = 4096  # Gaussians, at least, from which the distance of the scene is estimated


def near_plane(means: Tensor | np.ndarray, viewmat: Tensor | np.ndarray) -> float:
    """Scene units: NEAR as a share of DISTANCE, of the median depth of the means [N, 3] before the camera [4, 4].

    So what a camera sees does not depend on the unit that its scene is in.
    """
    row = np.asarray(torch.as_tensor(viewmat)[2].detach().cpu(), np.float64)
    some = np.asarray(torch.as_tensor(means[:: max(1, len(means) // _LOOKED_AT)]).detach().cpu(), np.float64)
    depth = some @ row[:3] + row[3]
    before = depth[depth > 0]
    return NEAR * float(np.median(before)) / DISTANCE if len(before) else NEAR


def drawn_from(means: Tensor, viewmat: Tensor) -> tuple[Tensor, float]:
    """Return means [N, 3] and near plane for a rasteriser, so that nothing nearer than `near_plane` is drawn.

    To ask a GPU for that plane would be to wait for it: there, what is nearer goes behind the camera.
    """
    if means.device.type == "cpu":
        return means, near_plane(means, viewmat)
    return without_near(means, viewmat), 0.0


def without_near(means: Tensor, viewmat: Tensor) -> Tensor:
    """Means [N, 3], those between the camera [4, 4] and `near_plane` mirrored behind it; nothing leaves the device."""
    depth = means @ viewmat[2, :3] + viewmat[2, 3]
    some = depth[:: max(1, len(means) // _LOOKED_AT)].detach()
    near = NEAR / DISTANCE * torch.where(some > 0, some, torch.nan).nanmedian()
    is_near = (depth > 0) & ~(depth > near)
    return torch.where(is_near[:, None], means - 2 * depth[:, None] * viewmat[2, :3], means)


@dataclass(frozen=True)
class RenderedView:
    """A picture over white and the channel that carries error back."""

    rgb: Tensor  # [H, W, 3]
    carrier: Tensor  # [H, W], zero
    shares: Callable[[], Tensor]  # [N] Σ weight × gradient of the carrier; call it after backward()


def render_view(
    gaussians: Gaussians,
    viewmat: Tensor,
    K: Tensor,
    size: tuple[int, int],
    degree: int,
    eps2d: float = EPS2D,
    near: float | None = None,
) -> RenderedView:
    """Render one camera (viewmat [4, 4], K [3, 3]) at size (width, height) with SH up to `degree`.

    eps2d: low-pass, squared pixels. near: scene units; None, `near_plane`.
    """
    if near is None:
        means, near = drawn_from(gaussians.means, viewmat)
        gaussians = replace(gaussians, means=means)
    if gaussians.means.is_cuda:
        return _render_cuda(gaussians, viewmat, K, size, degree, eps2d, near)
    from tg4mm.fit.rasterize.api import View, rasterize_cpu
    from tg4mm.fit.rasterize.kernels.layout import FEAT

    g = gaussians
    view = View(*size, near, FAR, eps2d, degree)
    images, transmittances, (record,) = rasterize_cpu(
        g.means, g.quats, g.scales, g.opacities, g.sh, viewmat[None], K[None], view
    )
    image, transmittance = images[0], transmittances[0]

    def shares() -> Tensor:
        assert record.v_splats is not None, "shares() before backward()"
        return torch.from_numpy(record.v_splats[:, FEAT + 3])

    return RenderedView(image[..., :3] + WHITE * transmittance[..., None], image[..., 3], shares)


def _render_cuda(
    gaussians: Gaussians,
    viewmat: Tensor,
    K: Tensor,
    size: tuple[int, int],
    degree: int,
    eps2d: float = EPS2D,
    near: float = NEAR,
) -> RenderedView:
    """Evaluate the colours here instead of in gsplat's rasterization.

    The carrier channel must be rendered with them, and gsplat would invert viewmat with a wait for the device.
    """
    from gsplat import spherical_harmonics

    from tg4mm.fit.rasterize import rasterization

    g = gaussians
    centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
    colours = torch.clamp_min(spherical_harmonics(degree, g.means - centre, g.sh) + 0.5, 0.0)
    carrier = torch.zeros(len(g), 1, device=g.means.device, requires_grad=True)
    renders, alphas, _ = rasterization(
        g.means, g.quats, g.scales, g.opacities, torch.cat([colours, carrier], 1),
        viewmat[None], K[None], *size, near, FAR, eps2d,
    )  # fmt: skip

    def shares() -> Tensor:
        assert carrier.grad is not None, "shares() before backward()"
        return carrier.grad[:, 0]

    return RenderedView(renders[0, ..., :3] + WHITE * (1 - alphas[0]), renders[0, ..., 3], shares)
