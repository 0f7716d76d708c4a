"""The same problem seen in smaller pictures: for what needs many iterations and no fine detail.

A pixel of the smaller picture is the mean of f × f pixels and counts as f² of them, so that white noise and slopes
which are smooth over f pixels tell as much of the motion as before. Texture finer than that is lost: more is said to be
unknown, never less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tg4mm.motion.jacobian.view import view_jacobian
from tg4mm.motion.nuisance import Nuisance, nuisances_of
from tg4mm.motion.observations import PosedFrames
from tg4mm.motion.problem import Problem

ENOUGH = 120_000  # pixels of a view


def coarser(
    problem: Problem, frames: Sequence[PosedFrames], weights: np.ndarray | None, enough: int = ENOUGH
) -> tuple[Problem, np.ndarray | None]:
    """The problem and its pixel weights [V, H, W] in pictures of `enough` pixels or a little more; else as they are."""
    height, width = problem.size
    factor = int(np.sqrt(height * width / enough))
    if factor < 2:
        return problem, weights
    scale = np.diag([1 / factor, 1 / factor, 1]).astype(np.float32)
    small = [replace(f, K=scale @ f.K) for f in frames]
    size = width // factor, height // factor
    views = [view_jacobian(problem.gaussians, f, size) for f in small]
    nuisances: Sequence[Nuisance] = ()
    if problem.nuisances:
        nuisances = nuisances_of(views, small, problem.gaussians.means.numpy(), problem.nuisances[0].active)
    own = np.full((len(views), *size[::-1]), factor**2, np.float32)
    if weights is not None:
        own *= _binned(weights[..., None], factor)[..., 0]
    means = None if problem.means is None else _binned(problem.means, factor)
    return replace(problem, views=views, nuisances=nuisances, means=means, projections=None, _kept={}), own


def _binned(pictures: np.ndarray, factor: int) -> np.ndarray:
    """[V, H, W, C] by the mean of factor × factor pixels; what is left over at the right and below is dropped."""
    n, height, width, channels = pictures.shape
    h, w = height // factor, width // factor
    blocks = pictures[:, : h * factor, : w * factor].reshape(n, h, factor, w, factor, channels)
    return np.ascontiguousarray(blocks.mean((2, 4), dtype=np.float32))
