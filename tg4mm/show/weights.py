"""Blending weights: how much of the pixels each Gaussian makes, by the rasteriser's own gradient."""

from __future__ import annotations

import numpy as np
import torch

from tg4mm.capture import Capture
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.rasterize import rasterization


def blending_weights(gaussians: Gaussians, capture: Capture) -> np.ndarray:
    """Each Gaussian's blending weight at rest: Σ over images and pixels of α·T ([3DGS] Eq. (3)), [N] float64.

    In pixels. It is the gradient of the summed rendering with respect to the Gaussian's colour, which the
    rasteriser gives exactly. A camera that took several images is rendered once and counts that many times.
    """
    device = gaussians.means.device
    colors = torch.ones(len(gaussians), 1, device=device, requires_grad=True)
    g = gaussians.detach()
    total = np.zeros(len(gaussians))
    _, first, counts = np.unique(capture.camera_ids, return_index=True, return_counts=True)
    for i, count in zip(first, counts, strict=True):
        row = slice(i, i + 1)
        view = torch.as_tensor(capture.viewmats[row], dtype=torch.float32, device=device)
        k = torch.as_tensor(capture.Ks[row], dtype=torch.float32, device=device)
        image, _, _ = rasterization(
            g.means, g.quats, g.scales, g.opacities, colors, view, k, capture.width, capture.height
        )
        (gradient,) = torch.autograd.grad(image.sum(), colors)
        total += count * gradient[:, 0].double().cpu().numpy()
    return total
