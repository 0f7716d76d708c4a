"""The rasteriser's low-pass made part of the Gaussians, for files whose viewers have none of their own.

Training draws every Gaussian wider by 0.3 px² (`eps2d`) with its opacity as it is, so trained Gaussians may be much
thinner than a pixel. Where nothing widens them they leave holes; a viewer that widens by 0.3 px² of a larger picture
shows needles. Here each gets that width in scene units, at the distances of the training cameras: a 3D smoothing filter
as in Mip-Splatting (Yu et al. 2024). Opacities stay: they were trained for the wider Gaussians, and lowering
them as that filter does, by the ratio of the volumes, would take them away (docs/blender.md).
"""

from __future__ import annotations

import numpy as np

from tg4mm.capture import Capture
from tg4mm.core.progress import progress

BAKED_PX2 = 0.3  # square pixels of a training picture
_MARGIN = 0.15  # of the picture's size: what is so far outside still reaches into it


def smoothing_variance(means: np.ndarray, capture: Capture) -> np.ndarray:
    """[N] scene units²: BAKED_PX2 at each mean [N, 3], the average over the cameras that see it.

    What no camera sees gets the median of the others; 0 where none sees anything.
    """
    total, count = np.zeros(len(means)), np.zeros(len(means))
    _, rows = np.unique(capture.camera_ids, return_index=True)
    with progress("smoothing", len(rows), "cameras", brief=True) as update:
        for done, (viewmat, K) in enumerate(zip(capture.viewmats[rows], capture.Ks[rows], strict=True), 1):
            x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).T
            depth = np.maximum(z, 1e-9)
            u, v = K[0, 0] * x / depth + K[0, 2], K[1, 1] * y / depth + K[1, 2]
            seen = (z > 0.01) & _inside(u, capture.width) & _inside(v, capture.height)
            total += np.where(seen, z**2 / (K[0, 0] * K[1, 1]), 0.0)
            count += seen
            update(done)
    variance = BAKED_PX2 * total / np.maximum(count, 1)
    known = count > 0
    variance[~known] = np.median(variance[known]) if known.any() else 0.0
    return variance


def widened(scales: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Scales [N, 3] of the Gaussians convolved with round ones of variance [N]."""
    return np.sqrt(scales.astype(np.float64) ** 2 + variance[:, None])


def _inside(place: np.ndarray, size: int) -> np.ndarray:
    return (place > -_MARGIN * size) & (place < (1 + _MARGIN) * size)
