"""The rasteriser's low-pass made part of the Gaussians, for viewers that have none, and for who looks from close up.

Training draws every Gaussian wider by 0.3 px² (`eps2d`) with its opacity as it is, so trained Gaussians may be much
thinner than a pixel. Where nothing widens them they leave holes; a viewer that widens by 0.3 px² of a larger picture,
or from nearer than training ever was, shows needles. Here each gets that width in scene units, by the camera that
sampled it finest: the 3D smoothing filter of Mip-Splatting (Yu et al. 2024, Eq. 8). Opacities stay: they were trained
for the wider Gaussians; lowered as that filter does, by the ratio of the volumes, they would fade (docs/blender.md).
"""

import logging

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.core.progress import progress
from tg4mm.run import Run

BAKED_PX2 = 0.3  # square pixels of a training picture
_LOG = logging.getLogger("tg4mm")
_MARGIN = 0.15  # of the picture's size; Gaussians so far outside may reach into it
_NEARER = 0.9  # of the finest training sampling; a test view from among the training cameras is above 1


def smoothing_variance(means: np.ndarray, capture: Capture) -> np.ndarray:
    """Return [N] scene units²: BAKED_PX2 at each mean [N, 3], in the camera that sees and samples it finest.

    What no camera sees gets the median of the others; 0 where none sees anything.
    """
    finest = np.full(len(means), np.inf)
    _, rows = np.unique(capture.camera_ids, return_index=True)
    with progress("smoothing", len(rows), "cameras", brief=True) as update:
        for done, (viewmat, K) in enumerate(zip(capture.viewmats[rows], capture.Ks[rows], strict=True), 1):
            pixel, seen = _sampled(means, viewmat, K, capture.width, capture.height)
            finest = np.where(seen, np.minimum(finest, pixel), finest)
            update(done)
    known = np.isfinite(finest)
    finest[~known] = np.median(finest[known]) if known.any() else 0.0
    return BAKED_PX2 * finest


def smoothing_of(run: Run, warn: bool = True) -> np.ndarray | None:
    """Return variances [N] for `to_splat`; None, with a warning, without the dataset, whose cameras determine them."""
    if not run.dataset.is_dir():
        if warn:
            _LOG.warning(
                "%s, the dataset, is missing: scales are written as trained, thinner than Blender should draw them",
                run.dataset,
            )
        return None
    return smoothing_variance(run.load_space().means.numpy().astype(np.float64), load_capture(run.dataset))


def lacking(
    means: np.ndarray, variance: np.ndarray, camera: tuple[np.ndarray, np.ndarray, int, int]
) -> np.ndarray | None:
    """Return [N] variances that Gaussians lack for a `camera` (viewmat, K, width, height) nearer than training was.

    With them and the BAKED_PX2 that the rasteriser adds, no Gaussian is thinner than `variance` [N] makes it. None for
    a camera that is not nearer.
    """
    pixel, seen = _sampled(means, *camera)
    own = BAKED_PX2 * pixel
    if not seen.any() or np.median(own[seen] / np.maximum(variance[seen], 1e-300)) > _NEARER:
        return None
    return np.maximum(variance - own, 0.0)


def _sampled(
    means: np.ndarray, viewmat: np.ndarray, K: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the area of a pixel at each mean [N], scene units², and which means are in or near the picture."""
    x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).T
    depth = np.maximum(z, 1e-9)
    u, v = K[0, 0] * x / depth + K[0, 2], K[1, 1] * y / depth + K[1, 2]
    return z**2 / (K[0, 0] * K[1, 1]), (z > 0.01) & _inside(u, width) & _inside(v, height)


def widened(scales: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return scales [N, 3] of the Gaussians convolved with round ones of variance [N]."""
    return np.sqrt(scales.astype(np.float64) ** 2 + variance[:, None])


def _inside(place: np.ndarray, size: int) -> np.ndarray:
    return (place > -_MARGIN * size) & (place < (1 + _MARGIN) * size)
