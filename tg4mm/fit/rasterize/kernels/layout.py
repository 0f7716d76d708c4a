"""The packed record of a projected Gaussian and the constants of blending, shared by all kernels.

Columns are read four at a time: MX … CB and EX … L22 (`block_culling.py`), EY … R11 (`binning.py`).
`project.py` writes them in this order.
"""

from typing import Final

TILE: Final = 16  # pixels; a tile is TILE × TILE

# Columns of `splats` [N, SPLAT_WIDTH] float32, one cache line a Gaussian, and of its gradient.
MX: Final = 0  # mean in the image, pixels
MY: Final = 1
CA: Final = 2  # conic (inverse 2D covariance): a dx² / 2 + b dx dy + c dy² / 2
CB: Final = 3
CC: Final = 4
OP: Final = 5  # opacity
FEAT: Final = 6  # first of the FEATURES blended channels (colour, depth)
FEATURES: Final = 4
DEPTH: Final = 10  # z in the camera, scene units
# Half extents in x and y of the ellipse inside which alpha >= alpha_min, pixels; kept, because from the conic of a
# thin ellipse they would be lost to cancellation.
EY: Final = 11
EX: Final = 12
POWER: Final = 13  # ln(opacity / alpha_min): blending skips what lies further out; <= 0 means invisible
# The exponent as squares: alpha = opacity · 2^-(p² + q²), p = l11 dx + l12 dy, q = l22 dy, where
# l11 = SQUARES · CA · R11, l12 = SQUARES · CB · R11; L22 from the conic would be lost to cancellation.
R11: Final = 14  # 1 / sqrt(SQUARES · CA)
L22: Final = 15
SPLAT_WIDTH: Final = 16
# What blending gives to the gradient is summed over pairs before it is multiplied by what all pairs of a Gaussian
# share: in the columns MX … OP stand sums over pixels of v dx, v dy, v dx², v dx dy, v dy² and v, where v is the
# gradient by the logarithm of alpha, dx and dy the pixel from the mean; in the others the gradient itself.
# `project_backward` multiplies.
SQUARES: Final = 0.7213475204444817  # log2(e) / 2

ALPHA_MIN: Final = 1.0 / 255.0  # [3DGS]: smaller contributions are skipped
ALPHA_MAX: Final = 0.999  # gsplat: a Gaussian never blocks the light entirely
T_MIN: Final = 1e-4  # a pixel stops before its transmittance falls to this
