"""Rendering Gaussians to images, with gradients: numba kernels on the CPU, gsplat on CUDA."""

from tg4mm.rasterize.api import rasterization

__all__ = ["rasterization"]
