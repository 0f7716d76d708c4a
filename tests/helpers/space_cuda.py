"""gsplat's spherical harmonics, computed by the plain twin."""

import torch

from tests.helpers.dense import sh_colours

_FAR = 1000.0


def spherical_harmonics(degrees_to_use: int, dirs: torch.Tensor, coeffs: torch.Tensor) -> torch.Tensor:
    """gsplat's, by our twin: no 0.5 and no clamp, which a large constant coefficient keeps away."""
    sh = coeffs[:, : (degrees_to_use + 1) ** 2].double()
    lifted = torch.cat([sh[:, :1] + _FAR, sh[:, 1:]], 1)
    return (sh_colours(lifted, dirs.double()) - 0.5 - _FAR * 0.28209479177387814).to(coeffs.dtype)
