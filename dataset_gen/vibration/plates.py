"""Membranes and plates: modes of a drum skin (Bessel functions) and of a simply supported rectangle.

Both move along their normal and are zero outside their outline. With a `thickness` their reach along the
normal ends: full within half of it on either side, then falling smoothly to zero at the whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np

from .fields import Field
from .geometry import fade, plane
from .values import (
    Direction,
    MaybePositive,
    Point,
    Positive,
    Triple,
    direction,
    pair_of_positive,
    shown,
    whole,
)

_MOST = 20  # nodal lines of one kind


def bessel(order: int, z: np.ndarray) -> np.ndarray:
    """J_order(z) for z ≥ 0 by its integral (1/2π) ∫ cos(order τ − z sin τ) dτ over a turn.

    The trapezoidal rule on a periodic integrand converges faster than any power: with more nodes than z + order
    + 40 it is exact to rounding.
    """
    z = np.asarray(z, np.float64)
    nodes = int(np.max(z, initial=0.0)) + order + 48
    total = np.zeros_like(z)
    for tau in 2.0 * np.pi * np.arange(nodes) / nodes:
        total += np.cos(order * tau - z * np.sin(tau))
    return total / nodes


@lru_cache
def bessel_zero(order: int, number: int) -> float:
    """The `number`-th positive zero (from 1) of J_order."""
    # Zeros lie more than 2.4 apart and the first above `order`: no step of 0.5 jumps over two.
    z = 0.5 * np.arange(1, 8 * (order + 2 * number) + 20) + order
    values = bessel(order, z)
    start = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))[number - 1]
    low, high = float(z[start]), float(z[start + 1])
    sign = np.sign(values[start])
    while high - low > 4e-16 * high:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if np.sign(bessel(order, np.array(middle))) == sign else (low, middle)
    return 0.5 * (low + high)


def _pair(value: Any, low: int) -> tuple[int, int]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"{shown(value)} is not a pair of whole numbers")
    return whole(value[0], low, _MOST), whole(value[1], 1, _MOST)


def _drum_nodes(value: Any) -> tuple[int, int]:
    return _pair(value, 0)


def _plate_nodes(value: Any) -> tuple[int, int]:
    return _pair(value, 1)


def _reach(height: np.ndarray, thickness: float | None) -> np.ndarray | float:
    return 1.0 if thickness is None else fade(np.abs(height), 0.5 * thickness, thickness)


@dataclass(frozen=True)
class Membrane(Field):
    """Mode of a drum skin: J_m(j_mn r/R) cos mθ along the normal, exactly 0 at and beyond the rim R.

    `nodes` [m, n]: m nodal diameters, n nodal circles counting the rim. θ is measured from `x` (default: world
    x, or y if the skin faces x).
    """

    kind: ClassVar[str] = "membrane"
    centre: Point
    normal: Direction
    radius: Positive
    nodes: Annotated[tuple[int, int], _drum_nodes] = (0, 1)
    x: Annotated[Triple | None, direction] = None
    thickness: MaybePositive = None

    def __post_init__(self) -> None:
        plane(self.normal, self.x, "normal: x")

    def __call__(self, points: np.ndarray) -> np.ndarray:
        u, v, n = plane(self.normal, self.x, "normal: x")
        order, number = self.nodes
        arm = points - np.array(self.centre)
        a, b = arm @ u, arm @ v
        r = np.hypot(a, b) / self.radius
        inside = r < 1.0
        height = np.zeros(len(points))
        height[inside] = bessel(order, bessel_zero(order, number) * r[inside])
        height *= np.cos(order * np.arctan2(b, a)) * _reach(arm @ n, self.thickness)
        return height[:, None] * n


@dataclass(frozen=True)
class Plate(Field):
    """Mode of a simply supported rectangle: m and n half waves of a sine along its sides, 0 outside.

    `size` [a, b]: the side along `x` and the other.
    """

    kind: ClassVar[str] = "plate"
    centre: Point
    normal: Direction
    x: Direction
    size: Annotated[tuple[float, float], pair_of_positive]
    nodes: Annotated[tuple[int, int], _plate_nodes] = (1, 1)
    thickness: MaybePositive = None

    def __post_init__(self) -> None:
        plane(self.normal, self.x, "normal: x")

    def __call__(self, points: np.ndarray) -> np.ndarray:
        u, v, n = plane(self.normal, self.x, "normal: x")
        arm = points - np.array(self.centre)
        height = np.ones(len(points))
        for axis, side, half_waves in ((u, self.size[0], self.nodes[0]), (v, self.size[1], self.nodes[1])):
            where = arm @ axis / side + 0.5
            inside = (where > 0.0) & (where < 1.0)
            height *= np.where(inside, np.sin(half_waves * np.pi * where), 0.0)
        return (height * _reach(arm @ n, self.thickness))[:, None] * n
