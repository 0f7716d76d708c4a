"""The rendering Jacobian by colour: a pixel's derivative by a Gaussian's colour is its blending weight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tg4mm.motion.jacobian.packed import COLUMNS, DOF, pack
from tg4mm.motion.jacobian.view import ViewJacobian

_COLOUR = COLUMNS - 3  # first column of a splat's colour


def colour_jacobian(view: ViewJacobian, active: np.ndarray) -> ViewJacobian:
    """The view with the Jacobian by colour in place of displacement (the first three of DOF; the others give 0).

    active [n_visible, 3] bool, in the order of bins.order: channels whose derivative is not 0 (not clamped).
    """
    jacobian = np.zeros((len(active), COLUMNS, DOF), np.float32)
    for c in range(3):
        jacobian[:, _COLOUR + c, c] = active[:, c]
    return replace(view, packed=pack(jacobian))


def without_colour(view: ViewJacobian) -> ViewJacobian:
    """The view with colours that no motion changes, as if they were the same from all sides."""
    jacobian = view.jacobian
    jacobian[:, _COLOUR:] = 0
    return replace(view, packed=pack(jacobian))


def blend_sum(view: ViewJacobian, picture: np.ndarray) -> np.ndarray:
    """[N, 3] float32: a picture [H, W, 3] summed over pixels by each Gaussian's blending weights."""
    out = np.zeros((1, len(view.splats), DOF), np.float32)
    colour_jacobian(view, np.ones((view.bins.n_visible, 3), bool)).vjp(picture[None], out)
    return out[0, :, :3]
