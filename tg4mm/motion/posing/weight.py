"""How alike neighbours move: the weight of the prior, found from the images by cross-validation.

How far motion reaches before it bends, and how much noise there is, differs from scene to scene by orders of magnitude:
what holds a noisy capture together ties parts of another to each other. So the strongest component is fitted to one
half of the cameras with every candidate, for a few iterations, and judged by how well it foretells the pictures of the
other half, whose noise it has not seen; the other way round says the same nearly always (docs/decisions.md). Errors of
the model (edges, shading) are alike in both halves and draw towards weights that are too small; hence the largest that
is within 0.8 % of the best.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.pcg import CGState, start, step, stepped
from tg4mm.motion.solver.problem import normals_of

Problem = Any  # MotionProblem or DeviceProblem; all of one kind
CANDIDATES = (10.0, 30.0, 100.0, 300.0, 1_000.0, 3_000.0)
DEFAULT = 300.0  # where the cameras are too few to be halved
ITERATIONS = 4  # of 16,000 Gaussians or fewer: the order of the candidates is settled by then
_WITHIN = 1.008  # of the least error


def chosen_weight(
    problems: Sequence[Problem],
    parts: Sequence[np.ndarray],
    pictures: np.ndarray,
    iterations: int = ITERATIONS,
) -> tuple[float, CGState | None]:
    """The weight for component images [V, H, W, 3], from the problem of each candidate (ascending), all cameras.

    And how far the fit to the first of `parts`, two halves of the cameras, has come with that weight; None if it
    would have ended before. `DEFAULT` and None where the images of a half do not change.
    """
    some, others = parts
    if not (pictures[some].any() and pictures[others].any()):
        return DEFAULT, None
    posed = [p.of_views(some) for p in problems]
    states, least = _solved(posed, pictures[some], iterations)
    fields = [p.field(state.x) for p, state in zip(posed, states, strict=True)]
    errors = problems[0].of_views(others).misfits(fields, pictures[others])
    best = int(np.flatnonzero(errors <= _WITHIN * errors.min())[-1])
    chosen = problems[best].config
    return float(chosen.neighbours), states[best] if least[best] > chosen.tolerance else None


def _solved(
    problems: Sequence[Problem], pictures: np.ndarray, iterations: int
) -> tuple[list[CGState], np.ndarray]:
    """A few iterations of each, on the CPU all in the same passes over the views; the least residual of each."""
    shown = problems[0].seen(pictures[:, None])[0]
    states = [start(p.to_parameters(shown)) for p in problems]
    least = np.full(len(problems), np.inf)
    for _ in range(iterations):
        least = np.minimum(least, [state.relative_residual for state in states])
        if isinstance(problems[0], DeviceProblem):
            states = [step(state, p.normal) for p, state in zip(problems, states, strict=True)]
            continue
        images = normals_of(problems, [state.direction for state in states])
        states = [stepped(state, image) for state, image in zip(states, images, strict=True)]
    return states, np.minimum(least, [state.relative_residual for state in states])
