"""How far a motion moves things in the pictures: pixels, over what each camera sees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tg4mm.motion.jacobian.linear import RestView
from tg4mm.motion.pictures.video import FixedCamera

PERCENT = 99.0  # of the Gaussians seen move by at most so many pixels
_CAMERAS = 8  # from so many, spread evenly, the share is known well enough


def pixels_moved(
    views: Sequence[RestView], cameras: Sequence[FixedCamera], means: np.ndarray, shift: np.ndarray
) -> float:
    """What 99 % of the Gaussians that a view sees move by at most, in up to eight views together; 0 if none is seen.

    means [N, 3] and shift [N, 3] in scene units.
    """
    some = np.unique(np.linspace(0, len(views) - 1, _CAMERAS).round().astype(int))
    moved = [_lengths(views[k], cameras[k], means, shift) for k in some]
    lengths = np.concatenate(moved)
    return float(np.percentile(lengths, PERCENT)) if len(lengths) else 0.0


def _lengths(view: RestView, camera: FixedCamera, means: np.ndarray, shift: np.ndarray) -> np.ndarray:
    rows = view.bins.order[: view.bins.n_visible]
    before, after = (_projected(camera, at[rows].astype(np.float64)) for at in (means, means + shift))
    return np.linalg.norm(after - before, axis=1)


def _projected(camera: FixedCamera, points: np.ndarray) -> np.ndarray:
    """Pixels [n, 2] of points [n, 3]; behind the camera they are taken as if a little before it."""
    q = points @ camera.viewmat[:3, :3].T.astype(np.float64) + camera.viewmat[:3, 3]
    q = q @ camera.K.T.astype(np.float64)
    return np.asarray(q[:, :2] / np.maximum(q[:, 2:], 1e-6))
