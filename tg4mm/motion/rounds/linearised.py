"""One round's problem: the pictures' remaining differences, and the Jacobians where the motion found so far leads.

The states are taken together once more, coarsely: states less than 0.7 pixels apart share a knot, at which the views
are linearised. At rest alone it would not do: from two pixels on, the picture's slope there says nothing of the slope
where things have moved to, and rounds with it drift away (docs/decisions.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from tg4mm.gaussians import Gaussians
from tg4mm.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.motion.pictures.states import states_of
from tg4mm.motion.pictures.video import FixedCamera
from tg4mm.motion.posing.pose import on_device
from tg4mm.motion.rounds.evidence import Evidence
from tg4mm.motion.rounds.moved import Array, MovedProblem, Problem, joined, shown
from tg4mm.motion.rounds.polish import at_state
from tg4mm.motion.solver.problem import MotionProblem

KNOTS = 5  # at most: each costs as much as the problem at rest
KNOT_PX = 0.7  # states less apart share one


@dataclass(frozen=True)
class Linearised:
    """Find the motion that explains the pictures, near the one it was made at."""

    problem: MovedProblem
    sides: list[Array]  # [R P, 3] for each part of the cameras, what its pictures say


def linearised(
    rest: MotionProblem,
    gaussians: Gaussians,
    evidence: Evidence,
    shapes: np.ndarray,
    pixels: np.ndarray,
    parts: Sequence[np.ndarray],
    device: str,
) -> Linearised:
    """The problem near `shapes` [R, N, DOF], which move things by `pixels` [R] for gains of 1.

    `rest`: the problem at rest, of which all but the views is taken. One knot's component images are held at a time.
    """
    left, _ = evidence.remaining(gaussians, shapes, device)
    states, motions = evidence.states, evidence.seen(shapes).motions
    knots = states_of(states.gains.T, pixels, KNOTS, KNOT_PX)
    problems: list[Problem] = []
    mix, sides = [], []
    for knot in range(len(knots.gains)):
        own = np.flatnonzero(knots.of == knot)
        share = states.count[own] / states.count[own].sum()
        motion = np.tensordot(share, motions[own], 1).astype(np.float32)
        views = _views(gaussians, motion, evidence.cameras, rest.views[0])
        problem = on_device(replace(rest, views=views), device)
        target = evidence.target(left, own, shown(problem, shapes))
        sides.append([joined(problem.of_views(p).right_hand_sides(target[p])) for p in parts])
        del target  # before the next one is made
        problems.append(problem)
        mix.append(states.products[own].sum(0))
    summed = [sum(of_part[1:], start=of_part[0]) for of_part in zip(*sides, strict=True)]
    return Linearised(MovedProblem(problems, np.stack(mix)), summed)


def _views(
    gaussians: Gaussians, motion: np.ndarray, cameras: list[FixedCamera], like: ViewJacobian
) -> list[ViewJacobian]:
    height, width = like.transmittance.shape
    moved = at_state(gaussians, torch.from_numpy(motion))
    return [view_jacobian(moved, camera, (width, height)) for camera in cameras]
