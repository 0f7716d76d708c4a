"""Conjugate gradients on numpy arrays or torch tensors, one iteration at a time, several systems at once.

The preconditioner is a change of variables in the operator (`preconditioner.py`), so these are the plain recurrences
(Hestenes & Stiefel 1952).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch

_EXACT = 1e-14  # squared relative residual
Array = Any  # np.ndarray or Tensor; a state holds one kind


@dataclass(frozen=True)
class CGState:
    """The iterate of A x = b."""

    x: Array
    residual: Array  # b − A x
    direction: Array
    initial: float  # |b|²
    iteration: int = 0

    @property
    def is_exact(self) -> bool:
        """Whether converged to float32's digits; more iterations would only add rounding errors."""
        return self.squared_residual <= _EXACT * self.initial

    @cached_property
    def squared_residual(self) -> float:
        return _inner(self.residual, self.residual)

    @property
    def relative_residual(self) -> float:
        """|b − A x| / |b|; 0 if b is 0."""
        return (self.squared_residual / self.initial) ** 0.5 if self.initial > 0 else 0.0


def start(b: Array) -> CGState:
    """From x = 0."""
    zero = np.zeros_like(b) if isinstance(b, np.ndarray) else torch.zeros_like(b)
    return CGState(zero, b, b, _inner(b, b))


def step(state: CGState, operator: Callable[[Array], Array]) -> CGState:
    """One iteration; `operator` is symmetric positive definite. Returns the state unchanged once it is exact."""
    return step_all([state], lambda directions: [operator(d) for d in directions])[0]


def step_all(
    states: Sequence[CGState], operator: Callable[[Sequence[Array]], Sequence[Array]]
) -> list[CGState]:
    """One iteration of each of several independent systems; `operator` is applied to all directions at once.

    Those that are exact stay as they are.
    """
    open_ = [k for k, state in enumerate(states) if not state.is_exact]
    images = operator([states[k].direction for k in open_]) if open_ else []
    out = list(states)
    for k, image in zip(open_, images, strict=True):
        out[k] = stepped(states[k], image)
    return out


def stepped(state: CGState, image: Array) -> CGState:
    """The next state; `image` is the operator applied to the direction. An exact one stays as it is."""
    before = state.squared_residual
    if before <= _EXACT * state.initial:
        return state
    alpha = before / _inner(state.direction, image)
    residual = _cast(state.residual - alpha * image, state.x)
    beta = _inner(residual, residual) / before
    return replace(
        state,
        x=_cast(state.x + alpha * state.direction, state.x),
        residual=residual,
        direction=_cast(residual + beta * state.direction, state.x),
        iteration=state.iteration + 1,
    )


def placed(state: CGState, device: str) -> CGState:
    """The state on a torch device; arrays stay arrays on the CPU."""
    if device == "cpu":
        return state
    x, residual, direction = (
        torch.from_numpy(a).to(device) for a in (state.x, state.residual, state.direction)
    )
    return replace(state, x=x, residual=residual, direction=direction)


def on_cpu(values: Array) -> np.ndarray:
    """The array or tensor as a contiguous array."""
    return np.ascontiguousarray(values if isinstance(values, np.ndarray) else values.cpu().numpy())


def _inner(a: Array, b: Array) -> float:
    """Σ a b, summed in float64."""
    wide = a.astype(np.float64) if isinstance(a, np.ndarray) else a.double()
    return float((wide * b).sum())


def _cast(a: Array, like: Array) -> Array:
    return a.astype(like.dtype) if isinstance(a, np.ndarray) else a.to(like.dtype)
