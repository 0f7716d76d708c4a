"""Conjugate gradients for one coupled system or several independent ones at once, on numpy arrays or torch tensors."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from tg4mm.fit.motion.solver.operator import Array, System
from tg4mm.fit.rasterize.kernels.compiled import on_each

_EXACT = 1e-12  # squared relative residual: the limit of float32; further iterations only add up rounding, and diverge


@dataclass(frozen=True)
class Solution:
    """θ [R, P, 3] (or of any shape [R, …]) and the residual b − A θ."""

    theta: Array
    residual: Array
    norms: np.ndarray  # [S] |b|² of each system; S = 1 where they are coupled, else R


def pcg(
    operator: System,
    b: Array,
    iterations: int,
    tolerance: float,
    norms: np.ndarray | None = None,
    update: Callable[[int, float], None] | None = None,
    together: int | None = None,
) -> Solution:
    """Solve A θ = b [R, P, 3] from θ = 0, by at most so many iterations of each system.

    A system ends at a relative residual of `tolerance`, measured against `norms` [S] (|b|² unless given). `update` is
    called with the iterations done and the largest relative residual. `together`: how many parts of θ make up a system;
    None for all of them where they are coupled, else one.
    """
    together = together or (len(b) if operator.is_coupled else 1)
    n = len(b) // together
    theta, residual, direction = b - b, 1 * b, 1 * b
    squares = np.array([_inner(one, one) for one in b]).reshape(n, -1).sum(1)
    norms = squares.copy() if norms is None else norms
    limit = np.maximum(max(tolerance**2, _EXACT) * norms, 1e-300)
    for done in range(iterations):
        going = np.flatnonzero(squares > limit)
        if not len(going):
            break
        _step(operator, (theta, residual, direction), squares, going.tolist(), together)
        if update is not None:
            update(done + 1, float(np.sqrt((squares / np.maximum(norms, 1e-300)).max())))
    return Solution(theta, residual, norms)


def _step(
    operator: System, state: tuple[Array, Array, Array], squares: np.ndarray, going: list[int], together: int
) -> None:
    """One iteration of the systems `going`, in place."""
    theta, residual, direction = state
    rows = [s * together + k for s in going for k in range(together)]
    images = operator.products(direction, None if len(rows) == len(theta) else rows)

    def advance(i: int) -> None:
        s = going[i]
        solved = range(s * together, (s + 1) * together)
        in_images = range(i * together, (i + 1) * together)
        curvature = sum(_inner(direction[r], images[q]) for r, q in zip(solved, in_images, strict=True))
        length = squares[s] / curvature
        for r, q in zip(solved, in_images, strict=True):
            theta[r] += length * direction[r]
            residual[r] -= length * images[q]
        after = sum(_inner(residual[r], residual[r]) for r in solved)
        for r in solved:
            direction[r] *= after / squares[s]
            direction[r] += residual[r]
        squares[s] = after

    if isinstance(theta, np.ndarray):
        on_each(advance, range(len(going)))
    else:
        for i in range(len(going)):
            advance(i)


def sent(values: np.ndarray, device: str) -> Array:
    """The array on a torch device; on the CPU itself."""
    return values if device == "cpu" else torch.from_numpy(np.ascontiguousarray(values)).to(device)


def fetched(values: Array) -> np.ndarray:
    """The array or tensor as a contiguous array."""
    return np.ascontiguousarray(values if isinstance(values, np.ndarray) else values.cpu().numpy())


def _inner(a: Array, b: Array) -> float:
    """Σ a b, summed in float64."""
    if isinstance(a, np.ndarray):
        return float(np.dot(a.ravel().astype(np.float64), b.ravel()))
    return float((a.double() * b).sum())
