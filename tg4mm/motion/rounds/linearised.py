"""One round's problem: the pictures' remaining differences, and the Jacobians where the motion found so far leads.

The states are taken together once more, coarsely: states less than 0.7 pixels apart share a knot, at which the views
are linearised. At rest alone it would not do: from two pixels on, the picture's slope there says nothing of the slope
where things have moved to, and rounds with it drift away (docs/decisions.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from tg4mm.gaussians import Gaussians
from tg4mm.motion.jacobian.linear import RestView, rest_view
from tg4mm.motion.pictures.states import States, states_of
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.motion.rounds.moved import MovedProblem, Problem, shown
from tg4mm.motion.rounds.polish import Seen, at_state
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.problem import MotionProblem
from tg4mm.rasterize import rasterization

KNOTS = 5  # at most: each costs as much as the problem at rest
KNOT_PX = 0.7  # states less apart share one


@dataclass(frozen=True)
class Linearised:
    """Find the motion that explains the pictures, near the one it was made at."""

    problem: MovedProblem
    targets: list[np.ndarray]  # for each knot [V, R, H, W, 3]


@torch.no_grad()
def rendered(gaussians: Gaussians, seen: Seen, device: str) -> np.ndarray:
    """[V, K, H, W, 3] float32: what the cameras see of the Gaussians moved to every state, over white."""
    height, width = seen.pictures.shape[2:4]
    there = gaussians.to(device)
    viewmats, Ks = (
        torch.from_numpy(np.stack([getattr(c, name) for c in seen.cameras])).to(device)
        for name in ("viewmat", "K")
    )
    out = np.empty_like(seen.pictures)
    for k, motion in enumerate(seen.motions):
        g = at_state(there, torch.from_numpy(motion).to(device))
        for v in range(len(viewmats)):
            rgb, _, _ = rasterization(
                g.means, g.quats, g.scales, g.opacities, g.sh, viewmats[v : v + 1], Ks[v : v + 1],
                width, height, sh_degree=g.sh_degree, backgrounds=torch.ones(1, 3, device=device),
            )  # fmt: skip
            out[v, k] = rgb[0].cpu().numpy()
    return out


def remaining(gaussians: Gaussians, seen: Seen, states: States, device: str) -> np.ndarray:
    """[V, K, H, W, 3]: pictures less what is rendered, each less its mean over time, which holds what stands still."""
    left = seen.pictures - rendered(gaussians, seen, device)
    share = (states.count / states.count.sum()).astype(np.float32)
    left -= np.einsum("vkhwc,k->vhwc", left, share)[:, None]
    return left


def misfit(left: np.ndarray, states: States) -> float:
    """Σ over timesteps, pixels and channels of squared differences [V, K, H, W, 3]."""
    squares = [float(np.einsum("vhwc,vhwc->", s, s, dtype=np.float64)) for s in left.swapaxes(0, 1)]
    return float(squares @ states.count)


def linearised(
    rest: MotionProblem,
    gaussians: Gaussians,
    seen: Seen,
    shapes: np.ndarray,
    left: np.ndarray,
    states: States,
    pixels: np.ndarray,
    device: str,
) -> Linearised:
    """The problem near `shapes` [R, N, DOF], which move things by `pixels` [R] for gains of 1.

    `rest`: the problem at rest, of which all but the views is taken. `left`: of `remaining`.
    """
    knots = states_of(states.gains.T, pixels, KNOTS, KNOT_PX)
    weighted = states.gains * states.count[:, None]
    problems: list[Problem] = []
    mix, targets = [], []
    for knot in range(len(knots.gains)):
        own = np.flatnonzero(knots.of == knot)
        share = states.count[own] / states.count[own].sum()
        motion = np.tensordot(share, seen.motions[own], 1).astype(np.float32)
        problem = _placed(replace(rest, views=_views(gaussians, motion, seen.cameras, rest.views[0])), device)
        mix.append(weighted[own].T @ states.gains[own])
        target = np.einsum("vkhwc,kr->vrhwc", left[:, own], weighted[own].astype(np.float32))
        target += np.einsum("rq,vqhwc->vrhwc", mix[-1].astype(np.float32), shown(problem, shapes))
        problems.append(problem)
        targets.append(target)
    return Linearised(MovedProblem(problems, np.stack(mix)), targets)


def _placed(problem: MotionProblem, device: str) -> Problem:
    return problem if device == "cpu" else DeviceProblem(problem, device)


def _views(
    gaussians: Gaussians, motion: np.ndarray, cameras: list[FixedCamera], like: RestView
) -> list[RestView]:
    height, width = like.transmittance.shape
    moved = at_state(gaussians, torch.from_numpy(motion))
    return [rest_view(moved, camera, (width, height)) for camera in cameras]
