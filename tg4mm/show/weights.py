"""Blending weights: how much of the pixels each Gaussian makes, by the rasteriser's own gradient."""

import numpy as np
import torch

from tg4mm.capture import Capture
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space.view import drawn_from


def blending_weights(gaussians: Gaussians, capture: Capture) -> np.ndarray:
    """Each Gaussian's blending weight at rest: Σ over images and pixels of α·T ([3DGS] Eq. (3)), [N] float64.

    In pixels. It is the gradient of the summed rendering with respect to the Gaussian's colour, which the
    rasteriser gives exactly. A camera that took several images is rendered once and counts that many times.
    """
    total = np.zeros(len(gaussians))
    _, first, counts = np.unique(capture.camera_ids, return_index=True, return_counts=True)
    ones = np.ones((capture.height, capture.width, 1), np.float32)
    for i, count in zip(first, counts, strict=True):
        total += count * pixel_sums(gaussians, ones, capture.viewmats[i], capture.Ks[i])[:, 0]
    return total


def pixel_sums(gaussians: Gaussians, maps: np.ndarray, viewmat: np.ndarray, K: np.ndarray) -> np.ndarray:
    """[N, C] float64: Σ over pixels of blending weight times maps [H, W, C], in the camera viewmat [4, 4], K [3, 3]."""
    g, device = gaussians.detach(), gaussians.means.device
    height, width, channels = maps.shape
    colors = torch.ones(len(g), channels, device=device, requires_grad=True)
    view, k = (torch.as_tensor(m, dtype=torch.float32, device=device)[None] for m in (viewmat, K))
    means, near = drawn_from(g.means, view[0])
    image, _, _ = rasterization(means, g.quats, g.scales, g.opacities, colors, view, k, width, height, near)
    target = torch.as_tensor(maps, dtype=torch.float32, device=device)
    (gradient,) = torch.autograd.grad((image[0] * target).sum(), colors)
    return np.asarray(gradient.double().cpu().numpy())
