"""Conjugate gradients for one coupled system or several independent ones at once, on numpy arrays or torch tensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from tg4mm.motion.solver.operator import Array, System

_EXACT = 1e-14  # squared relative residual: to the digits of float32, going on would only add up rounding


@dataclass(frozen=True)
class Solution:
    """θ [R, P, 3] (or of any shape [R, …]) and what is left of the right-hand sides, b − A θ."""

    theta: Array
    residual: Array
    norms: np.ndarray  # [S] |b|² of each system; S = 1 where they are coupled, else R
    iterations: int

    @property
    def relative_residual(self) -> float:
        """The largest |b − A θ| / |b|."""
        return float(
            np.sqrt(np.max(_squares(self.residual, len(self.norms)) / np.maximum(self.norms, 1e-300)))
        )


def pcg(
    operator: System,
    b: Array,
    iterations: int,
    tolerance: float,
    norms: np.ndarray | None = None,
    update: Callable[[int, float], None] | None = None,
) -> Solution:
    """Solve A θ = b [R, P, 3] from θ = 0, by at most so many iterations of each system.

    A system ends at a relative residual of `tolerance`, measured against `norms` [S] (|b|² unless given). `update` is
    called with the iterations done and the largest relative residual.
    """
    n = 1 if operator.is_coupled else len(b)
    theta, residual, direction = _zeros(b), _copy(b), _copy(b)
    squares = _squares(b, n)
    norms = squares if norms is None else norms
    limit = np.maximum(max(tolerance**2, _EXACT) * norms, 1e-300)
    done = 0
    for _ in range(iterations):
        going = np.flatnonzero(squares > limit)
        if not len(going):
            break
        rows = range(len(b)) if operator.is_coupled else going
        _step(operator, theta, residual, direction, squares, list(rows), n)
        done += 1
        if update is not None:
            update(done, float(np.sqrt((squares / np.maximum(norms, 1e-300)).max())))
    return Solution(theta, residual, norms, done)


def _step(
    operator: System,
    theta: Array,
    residual: Array,
    direction: Array,
    squares: np.ndarray,
    rows: list[int],
    n: int,
) -> None:
    """One iteration of the systems `rows`, in place."""
    images = operator.products(direction, None if n == 1 and len(rows) == len(theta) else rows)
    systems = [rows] if operator.is_coupled else [[r] for r in rows]
    for s, own in zip([0] if operator.is_coupled else rows, systems, strict=True):
        products = [_inner(direction[r], images[rows.index(r)]) for r in own]
        length = squares[s] / sum(products)
        for r in own:
            theta[r] += length * direction[r]
            residual[r] -= length * images[rows.index(r)]
        after = sum(_inner(residual[r], residual[r]) for r in own)
        for r in own:
            direction[r] *= after / squares[s]
            direction[r] += residual[r]
        squares[s] = after


def sent(values: np.ndarray, device: str) -> Array:
    """The array on a torch device; on the CPU itself."""
    return values if device == "cpu" else torch.from_numpy(np.ascontiguousarray(values)).to(device)


def fetched(values: Array) -> np.ndarray:
    """The array or tensor as a contiguous array."""
    return np.ascontiguousarray(values if isinstance(values, np.ndarray) else values.cpu().numpy())


def _squares(values: Array, n: int) -> np.ndarray:
    each = np.array([_inner(one, one) for one in values])
    return each if n == len(each) and n > 1 else each.sum(keepdims=True) if n == 1 else each


def _inner(a: Array, b: Array) -> float:
    """Σ a b, summed in float64."""
    if isinstance(a, np.ndarray):
        return float(np.dot(a.ravel().astype(np.float64), b.ravel()))
    return float((a.double() * b).sum())


def _zeros(b: Array) -> Array:
    return np.zeros_like(b) if isinstance(b, np.ndarray) else torch.zeros_like(b)


def _copy(b: Array) -> Array:
    return b.copy() if isinstance(b, np.ndarray) else b.clone()
