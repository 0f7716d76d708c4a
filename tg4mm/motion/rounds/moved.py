"""The problem linearised where things are, not at rest: one Jacobian for every few states that stand nearly alike.

With the states' poses no longer the same, the functions of time do not fall apart: a knot l with Jacobian J_l, whose
timesteps t have gains a(t), couples them by M_l = Σ a(t) a(t)ᵀ. The operator on all of them together is
Σ_l M_l ⊗ (the normal operator at knot l), and since the M_l add up to the identity, so do the priors. One knot at rest
is the plain problem again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from tg4mm.motion.solver.pcg import on_cpu

Problem = Any  # MotionProblem or DeviceProblem
Array = Any  # np.ndarray or Tensor


@dataclass(frozen=True)
class MovedProblem:
    """Unknowns θ [R P, 3]: the parameters of R components one below the other."""

    knots: Sequence[Problem]  # L problems that differ in their views' poses alone
    mix: np.ndarray  # [L, R, R] float64

    def of_views(self, rows: np.ndarray) -> MovedProblem:
        """The problem that only some of the views pose, as `MotionProblem.of_views`."""
        return MovedProblem([knot.of_views(rows) for knot in self.knots], self.mix)

    def normal(self, theta: Array) -> Array:
        """The symmetric operator of the problem applied to θ."""
        parts = _split(theta, self.mix.shape[1])
        images = [_mixed(m, knot.normals(parts)) for knot, m in zip(self.knots, self.mix, strict=True)]
        return sum(images[1:], start=images[0])

    def fields(self, theta: Array) -> np.ndarray:
        """[R, N, DOF] float32 displacement and rotation."""
        return np.stack([on_cpu(self.knots[0].field(part)) for part in _split(theta, self.mix.shape[1])])


def shown(problem: Problem, motions: np.ndarray) -> np.ndarray:
    """[V, R, H, W, 3] float32: the changes that R motions [R, N, DOF] make to the views' pictures, linearised."""
    if hasattr(problem, "device"):
        there = torch.from_numpy(np.ascontiguousarray(motions)).to(problem.device)
        return np.stack([np.stack([on_cpu(view.jvp(m)) for m in there]) for view in problem.views])
    return np.stack([view.jvp(motions) for view in problem.views])


def _split(theta: Array, n: int) -> list[Array]:
    rows = len(theta) // n
    return [theta[r * rows : (r + 1) * rows] for r in range(n)]


def joined(parts: Sequence[Array]) -> Array:
    """One below the other, arrays or tensors."""
    return np.concatenate(parts) if isinstance(parts[0], np.ndarray) else torch.cat(list(parts))


def _mixed(m: np.ndarray, parts: Sequence[Array]) -> Array:
    """Σ_q m[r, q] parts[q], for all r one below the other."""
    rows = [sum((float(w) * p for w, p in zip(row[1:], parts[1:], strict=True)), start=float(row[0]) * parts[0])
            for row in m]  # fmt: skip
    return joined(rows)
