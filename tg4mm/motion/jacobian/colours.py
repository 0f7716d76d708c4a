"""How a picture answers to changes of colour: by the blending weights, as a Jacobian of rendering at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tg4mm.motion.jacobian.linear import RestView
from tg4mm.motion.jacobian.packed import COLUMNS, DOF, packed

_COLOUR = COLUMNS - 3  # first column of a splat's colour


def of_colours(view: RestView, answering: np.ndarray) -> RestView:
    """The view with a Jacobian that takes displacements for changes of colour.

    answering [n_visible, 3] bool, in the order of bins.order: which channels answer.
    """
    jacobian = np.zeros((len(answering), COLUMNS, DOF), np.float32)
    for c in range(3):
        jacobian[:, _COLOUR + c, c] = answering[:, c]
    return replace(view, answers=packed(jacobian))


def blended(view: RestView, picture: np.ndarray) -> np.ndarray:
    """[N, 3] float32: a picture [H, W, 3] summed over pixels by each Gaussian's blending weights."""
    out = np.zeros((len(view.splats), DOF), np.float32)
    of_colours(view, np.ones((view.bins.n_visible, 3), bool)).pull(picture, out)
    return out[:, :3]
