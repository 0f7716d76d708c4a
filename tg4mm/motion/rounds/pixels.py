"""How far a motion moves things in the pictures: pixels, over what each camera sees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tg4mm.motion.jacobian.linear import RestView
from tg4mm.motion.pictures.video import FixedCamera

PERCENT = 99.0  # of the Gaussians seen move by at most so many pixels
_CAMERAS = 8  # from so many, spread evenly, the share is known well enough


def pixels_moved(
    views: Sequence[RestView], cameras: Sequence[FixedCamera], means: np.ndarray, shifts: np.ndarray
) -> np.ndarray:
    """[S]: what 99 % of the Gaussians that a view sees move by at most, in up to eight views; 0 if none is seen.

    means [N, 3] and S shifts [S, N, 3] in scene units.
    """
    some = np.unique(np.linspace(0, len(views) - 1, _CAMERAS).round().astype(int))
    moved = [_lengths(views[k], cameras[k], means, shifts) for k in some]
    lengths = np.concatenate(moved, 1)
    if not lengths.size:
        return np.zeros(len(shifts))
    return np.asarray(np.percentile(lengths, PERCENT, axis=1))


def _lengths(view: RestView, camera: FixedCamera, means: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """[S, n] pixels."""
    rows = view.bins.order[: view.bins.n_visible]
    at = means[rows].astype(np.float64)
    before = _projected(camera, at)
    return np.stack([np.linalg.norm(_projected(camera, at + s[rows]) - before, axis=1) for s in shifts])


def _projected(camera: FixedCamera, points: np.ndarray) -> np.ndarray:
    """Pixels [n, 2] of points [n, 3]; behind the camera they are taken as if a little before it."""
    whole = camera.K.astype(np.float64) @ camera.viewmat[:3].astype(np.float64)
    q = points @ whole[:, :3].T + whole[:, 3]
    return np.asarray(q[:, :2] / np.maximum(q[:, 2:], 1e-6))
