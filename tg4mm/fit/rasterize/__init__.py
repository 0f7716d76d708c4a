"""Rendering Gaussians to images, with gradients: numba kernels on the CPU, gsplat on CUDA.

`rasterization` is imported when it is first asked for: the kernels' constants need no torch.
"""

from typing import TYPE_CHECKING

from tg4mm.core.extras import lazily

if TYPE_CHECKING:
    from tg4mm.fit.rasterize.api import rasterization

__all__ = ["rasterization"]

__getattr__ = lazily(__name__, {"rasterization": "api"})
