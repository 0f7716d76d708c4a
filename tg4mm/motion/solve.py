"""Conjugate gradients that can be stopped and taken up again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class CGState:
    """Where the solution of A x = b stands."""

    x: np.ndarray
    residual: np.ndarray  # b − A x
    direction: np.ndarray
    initial: float  # |b|²
    iteration: int = 0

    @property
    def squared_residual(self) -> float:
        return float((self.residual.astype(np.float64) ** 2).sum())

    @property
    def relative_residual(self) -> float:
        """|b − A x| / |b|; 0 if b is 0."""
        return (self.squared_residual / self.initial) ** 0.5 if self.initial > 0 else 0.0


def start(b: np.ndarray) -> CGState:
    """From x = 0."""
    return CGState(np.zeros_like(b), b, b, float((b.astype(np.float64) ** 2).sum()))


def step(state: CGState, operator: Callable[[np.ndarray], np.ndarray]) -> CGState:
    """One iteration; `operator` is symmetric and positive. Returns the state unchanged once it is exact."""
    before = state.squared_residual
    if before == 0:
        return state
    image = operator(state.direction)
    length = before / float((state.direction.astype(np.float64) * image).sum())
    residual = (state.residual - length * image).astype(state.x.dtype)
    new = replace(
        state,
        x=(state.x + length * state.direction).astype(state.x.dtype),
        residual=residual,
        iteration=state.iteration + 1,
    )
    turn = new.squared_residual / before
    return replace(new, direction=(residual + turn * state.direction).astype(state.x.dtype))
