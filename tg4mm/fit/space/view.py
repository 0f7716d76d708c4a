"""One training view: the picture, and each Gaussian's share of its error once the loss went backward.

The share of Gaussian i is Σ over pixels of blending weight × error: the gradient of Σ error · (a channel that is
zero on every Gaussian) by that channel. The CPU kernels blend four channels anyway, so it costs nothing there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from tg4mm.fit.gaussians import Gaussians

WHITE = 1.0
NEAR, FAR, EPS2D = 0.01, 1e10, 0.3  # gsplat's defaults


@dataclass(frozen=True)
class RenderedView:
    """A picture over white and the channel that carries error back."""

    rgb: Tensor  # [H, W, 3]
    carrier: Tensor  # [H, W], zero
    shares: Callable[[], Tensor]  # [N] Σ weight × gradient of the carrier; call it after backward()


def render_view(
    gaussians: Gaussians, viewmat: Tensor, K: Tensor, size: tuple[int, int], degree: int, eps2d: float = EPS2D
) -> RenderedView:
    """Render one camera (viewmat [4, 4], K [3, 3]) at size (width, height) with SH up to `degree`.

    eps2d: low-pass, squared pixels.
    """
    if gaussians.means.is_cuda:
        return _render_cuda(gaussians, viewmat, K, size, degree, eps2d)
    from tg4mm.fit.rasterize.cpu import View, rasterize_cpu
    from tg4mm.fit.rasterize.kernels.layout import FEAT

    g = gaussians
    view = View(*size, NEAR, FAR, eps2d, degree, False)
    images, transmittances, (record,) = rasterize_cpu(
        g.means, g.quats, g.scales, g.opacities, g.sh, viewmat[None], K[None], view
    )
    image, transmittance = images[0], transmittances[0]

    def shares() -> Tensor:
        assert record.v_splats is not None, "shares() before backward()"
        return torch.from_numpy(record.v_splats[:, FEAT + 3])

    return RenderedView(image[..., :3] + WHITE * transmittance[..., None], image[..., 3], shares)


def _render_cuda(
    gaussians: Gaussians, viewmat: Tensor, K: Tensor, size: tuple[int, int], degree: int, eps2d: float = EPS2D
) -> RenderedView:
    """Colours are made here, not by gsplat's rasterization: the carrier must ride beside them, and gsplat would
    invert viewmat with a wait for the device."""
    from gsplat import spherical_harmonics

    from tg4mm.fit.rasterize import rasterization

    g = gaussians
    centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
    colours = torch.clamp_min(spherical_harmonics(degree, g.means - centre, g.sh) + 0.5, 0.0)
    carrier = torch.zeros(len(g), 1, device=g.means.device, requires_grad=True)
    renders, alphas, _ = rasterization(
        g.means, g.quats, g.scales, g.opacities, torch.cat([colours, carrier], 1),
        viewmat[None], K[None], *size, NEAR, FAR, eps2d,
    )  # fmt: skip

    def shares() -> Tensor:
        assert carrier.grad is not None, "shares() before backward()"
        return carrier.grad[:, 0]

    return RenderedView(renders[0, ..., :3] + WHITE * (1 - alphas[0]), renders[0, ..., 3], shares)
