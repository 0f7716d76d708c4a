"""How far what a camera sees moves in its picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tg4mm.motion.jacobian.linear import RestView
from tg4mm.motion.jacobian.packed import as_colours
from tg4mm.rasterize.buffers import Buffers


def flow(view: RestView, shapes: np.ndarray, buffers: Buffers) -> np.ndarray:
    """[R, H, W, 3] for motions [R, N, DOF]: right and down in pixels, then 0. Until the next call with `buffers`.

    Of each pixel the sum over the Gaussians seen there, by blending weight; the background stands still.
    """
    return replace(view, answers=as_colours(view.answers)).push_all(shapes, buffers)
