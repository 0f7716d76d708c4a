"""Optical flow of a motion, by the rendering Jacobian at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tg4mm.motion.jacobian.packed import mean_rows_as_colours
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.rasterize.buffers import Buffers


def optical_flow(view: ViewJacobian, motions: np.ndarray, buffers: Buffers) -> np.ndarray:
    """[R, H, W, 3] of motions [R, N, DOF]: right and down in pixels, then 0. Valid until the next call with `buffers`.

    Each pixel sums the flow of its Gaussians' means by blending weight; the background's flow is 0.
    """
    return replace(view, packed=mean_rows_as_colours(view.packed)).jvp(motions, buffers)
