"""How far a motion moves things in the pictures: pixels, over what each camera sees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tg4mm.motion.jacobian.linear import RestView
from tg4mm.motion.jacobian.packed import jacobian_of_means

PERCENT = 99.0  # of the Gaussians seen move by at most so many pixels
_CAMERAS = 8  # from so many, spread evenly, the share is known well enough


def pixels_moved(views: Sequence[RestView], shifts: np.ndarray) -> np.ndarray:
    """[S]: what 99 % of the Gaussians that a view sees move by at most, in up to eight views; 0 if none is seen.

    S shifts [S, N, 3] in scene units, each taken by the views' derivative.
    """
    some = np.unique(np.linspace(0, len(views) - 1, _CAMERAS).round().astype(int))
    lengths = np.concatenate([_lengths(views[k], shifts) for k in some], 1)
    if not lengths.size:
        return np.zeros(len(shifts))
    return np.asarray(np.percentile(lengths, PERCENT, axis=1))


def _lengths(view: RestView, shifts: np.ndarray) -> np.ndarray:
    """[S, n] pixels."""
    right, down = jacobian_of_means(view.answers)
    own = shifts[:, view.bins.order[: view.bins.n_visible]]
    return np.asarray(np.hypot(*(np.einsum("nd,snd->sn", row, own) for row in (right, down))))
