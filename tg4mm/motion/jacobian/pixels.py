"""How far a motion moves the Gaussians in the pictures, in pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tg4mm.motion.jacobian.packed import mean_rows
from tg4mm.motion.jacobian.view import ViewJacobian

PERCENT = 99.0  # of the visible Gaussians: outliers of a fit must not decide
_CAMERAS = 8  # views looked at, spread evenly


def pixels_moved(views: Sequence[ViewJacobian], shifts: np.ndarray) -> np.ndarray:
    """[S]: the 99th percentile over visible Gaussians, in up to eight views, of image motion; 0 if none is visible.

    S shifts [S, N, 3] in scene units, projected to first order.
    """
    some = np.unique(np.linspace(0, len(views) - 1, _CAMERAS).round().astype(int))
    lengths = np.concatenate([_lengths(views[k], shifts) for k in some], 1)
    if not lengths.size:
        return np.zeros(len(shifts))
    return np.asarray(np.percentile(lengths, PERCENT, axis=1))


def _lengths(view: ViewJacobian, shifts: np.ndarray) -> np.ndarray:
    """[S, n] pixels."""
    right, down = mean_rows(view.packed)
    own = shifts[:, view.bins.order[: view.bins.n_visible]]
    return np.asarray(np.hypot(*(np.einsum("nd,snd->sn", row, own) for row in (right, down))))
