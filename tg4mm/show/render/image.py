"""Pictures of Gaussians: colours, or any per-Gaussian quantity blended like colours."""

import numpy as np
import torch

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space.view import drawn_from, near_plane
from tg4mm.show.render.cameras import Camera

WHITE = (1.0, 1.0, 1.0)


def render(
    gaussians: Gaussians, camera: Camera, background: tuple[float, float, float] = WHITE
) -> np.ndarray:
    """Return a camera's picture of Gaussians, by `rasterization`.

    Args:
        gaussians: from `fit_space` or `animate`; if they are on CUDA, rendering is, too.
        camera: from `capture_cameras`, `orbit`, or any other.
        background: display-referred sRGB, 0..1.

    Returns:
        [height, width, 3] float32 in 0..1, display-referred sRGB.

    Raises:
        Tg4mmError: the Gaussians are on CUDA and gsplat is not installed.
    """
    return render_image(gaussians, *camera.view, background)


def render_image(
    gaussians: Gaussians,
    viewmat: np.ndarray,
    K: np.ndarray,
    width: int,
    height: int,
    background: tuple[float, float, float] = WHITE,
    low_pass_px2: float = 0.3,
) -> np.ndarray:
    """Return a display-referred sRGB picture [height, width, 3] float32 in 0..1; `viewmat` [4, 4], `K` [3, 3].

    `low_pass_px2`: variance that widens each drawn Gaussian, square pixels.
    """
    return render_images(gaussians, viewmat[None], K[None], (width, height), background, low_pass_px2)[0]


@torch.no_grad()
def render_images(
    gaussians: Gaussians,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    size: tuple[int, int],
    background: tuple[float, float, float] = WHITE,
    low_pass_px2: float = 0.3,
) -> np.ndarray:
    """Return `render_image` [C, height, width, 3] for cameras [C, 4, 4], [C, 3, 3] of one size (width, height)."""
    device = gaussians.means.device
    views, ks = (torch.as_tensor(m, dtype=torch.float32, device=device) for m in (viewmats, Ks))
    if len(views) == 1:
        means, near = drawn_from(gaussians.means, views[0])
    else:
        means, near = gaussians.means, min(near_plane(gaussians.means, view) for view in views)
    colours, _, _ = rasterization(
        means,
        gaussians.quats,
        gaussians.scales,
        gaussians.opacities,
        gaussians.sh,
        views,
        ks,
        *size,
        near_plane=near,
        eps2d=low_pass_px2,
        sh_degree=gaussians.sh_degree,
        backgrounds=torch.tensor([background], dtype=torch.float32, device=device).repeat(len(views), 1),
    )
    return np.asarray(colours.clamp(0.0, 1.0).cpu().numpy(), np.float32)


@torch.no_grad()
def render_features(
    gaussians: Gaussians, features: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of per-Gaussian `features` [N, F] in each pixel [H, W, F], weighted as colours; opacity [H, W].

    The mean of an empty pixel is 0.
    """
    device = gaussians.means.device
    view = torch.as_tensor(camera.viewmat, dtype=torch.float32, device=device)
    means, near = drawn_from(gaussians.means, view)
    blended, alphas, _ = rasterization(
        means,
        gaussians.quats,
        gaussians.scales,
        gaussians.opacities,
        torch.as_tensor(features, dtype=torch.float32, device=device),
        view[None],
        torch.as_tensor(camera.K, dtype=torch.float32, device=device)[None],
        camera.width,
        camera.height,
        near_plane=near,
    )
    opacity = alphas[0, ..., 0].cpu().numpy()
    mean = blended[0].cpu().numpy() / np.maximum(opacity, 1e-6)[..., None]
    return np.where(opacity[..., None] > 1e-6, mean, 0.0).astype(np.float32), opacity
