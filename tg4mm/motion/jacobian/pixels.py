"""What a motion does in the pictures to first order: how far things move in pixels, and its optical flow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tg4mm.motion.jacobian.packed import mean_rows, mean_rows_as_colours
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.rasterize.buffers import Buffers

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


def optical_flow(view: ViewJacobian, motions: np.ndarray, buffers: Buffers) -> np.ndarray:
    """[R, H, W, 3] of motions [R, N, DOF]: right and down in pixels, then 0. Valid until the next call with `buffers`.

    Each pixel sums the flow of its Gaussians' means by blending weight; the background's flow is 0.
    """
    return replace(view, packed=mean_rows_as_colours(view.packed)).jvp(motions, buffers)
