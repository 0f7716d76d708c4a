"""Displacement fields of structures: beams that bend, membranes and plates, waves that travel.

Membranes and plates move along their normal and are zero outside their outline. With a `thickness` their reach
along the normal ends: full within half of it on either side, then falling smoothly to zero at the whole.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np

from .fields import Field, across, fade, plane, unit
from .values import (
    Direction,
    MaybePositive,
    Point,
    Positive,
    Real,
    Triple,
    direction,
    pair_of_positive,
    positive,
    shown,
    vector,
    whole,
)

_MOST = 20  # nodal lines of one kind

# Roots β of cosh β cos β = −1, the frequency equation of the clamped-free beam.
_BETA = (1.8751040687119611, 4.694091132974175, 7.854757438237613)

# Rayleigh wave in a solid of Poisson's ratio 1/4: (c/c_shear)² is a root of ξ³ − 8ξ² + 56/3 ξ − 32/3.
_XI = 2.0 - 2.0 / np.sqrt(3.0)
_MIX = 1.0 - 0.5 * _XI
_DECAY_P, _DECAY_S = float(np.sqrt(1.0 - _XI / 3.0)), float(np.sqrt(1.0 - _XI))  # per wave number


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


def _order(value: Any) -> int:
    return whole(value, 1, len(_BETA))


@dataclass(frozen=True)
class Bending(Field):
    """Mode `order` of a beam clamped at `base`, free at `tip`; what it carries beyond follows rigidly.

    Cross-sections turn with the slope of the beam, so the field is continuous through everything that touches
    it, and exactly zero at and behind the base. The deflection is 1 at the tip. Of `direction` counts what is
    perpendicular to the beam.
    """

    kind: ClassVar[str] = "bending"
    base: Point
    tip: Point
    direction: Direction
    order: Annotated[int, _order] = 1

    def __post_init__(self) -> None:
        if np.linalg.norm(np.subtract(self.tip, self.base)) < 1e-9:
            raise ValueError(f"tip {self.tip} is the base: the beam has no length")
        across(self.direction, self._axis, "direction")

    @property
    def _axis(self) -> np.ndarray:
        return unit(np.subtract(self.tip, self.base))

    @property
    def length(self) -> float:
        """Length of the beam, scene units."""
        return float(np.linalg.norm(np.subtract(self.tip, self.base)))

    def profile(self, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Deflection w with w(tip) = 1, and its slope w' in 1/scene unit, at heights above the base."""
        beta = _BETA[self.order - 1]
        sigma = (np.sinh(beta) - np.sin(beta)) / (np.cosh(beta) + np.cos(beta))
        scale = 0.5 * (-1) ** (self.order + 1)
        height = np.asarray(height, np.float64)
        b = beta * np.clip(height / self.length, 0.0, 1.0)
        w = scale * (np.cosh(b) - np.cos(b) - sigma * (np.sinh(b) - np.sin(b)))
        slope = scale * (np.sinh(b) + np.sin(b) - sigma * (np.cosh(b) - np.cos(b))) * beta / self.length
        return w + slope * np.maximum(height - self.length, 0.0), slope

    def __call__(self, points: np.ndarray) -> np.ndarray:
        axis, arm = self._axis, points - np.array(self.base)
        sway = across(self.direction, axis, "direction")
        deflection, slope = self.profile(arm @ axis)
        return deflection[:, None] * sway - (slope * (arm @ sway))[:, None] * axis


@dataclass(frozen=True)
class BallRegion:
    """A ball in which a field acts: fully within half its radius, fading smoothly to 0 at its radius."""

    centre: Triple
    radius: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - np.array(self.centre), axis=1)
        return fade(distance, 0.5 * self.radius, self.radius)


def _region(value: Any) -> BallRegion:
    if not isinstance(value, dict) or set(value) != {"centre", "radius"}:
        raise ValueError(f"{shown(value)} is not of the form {{centre: [x, y, z], radius: r}}")
    return BallRegion(vector(value["centre"]), positive(value["radius"]))


def _polarisation(value: Any) -> Triple | str:
    if isinstance(value, str) and value != "rayleigh":
        raise ValueError(f"{value!r} is neither three numbers nor 'rayleigh'")
    return value if isinstance(value, str) else direction(value)


@dataclass(frozen=True)
class Wave(Field):
    """A plane wave exp(−i 2π (d·x)/wavelength): with exp(+iωt) it travels along `direction`, d.

    `polarisation`: the direction of a linear motion, or "rayleigh": the surface wave of an elastic solid below
    z = `level` (Poisson's ratio 1/4), whose points go round ellipses, backwards at the top, and which dies out
    with depth; what stands above the level moves as the surface does. `decay_length`: damping by 1/e per that
    distance from z = `level`, either side. `region`: where it acts at all.
    """

    kind: ClassVar[str] = "wave"
    direction: Direction
    wavelength: Positive
    polarisation: Annotated[Triple | str, _polarisation]
    decay_length: MaybePositive = None
    level: Real = 0.0
    region: Annotated[BallRegion | None, _region] = None

    def __post_init__(self) -> None:
        if self.polarisation == "rayleigh" and abs(unit(self.direction)[2]) > 1e-6:
            raise ValueError(
                f"direction {self.direction} of a Rayleigh wave must lie in the surface: its z must be 0"
            )

    def __call__(self, points: np.ndarray) -> np.ndarray:
        heading, number = unit(self.direction), 2.0 * np.pi / self.wavelength
        size = np.exp(-1j * number * (points @ heading))
        if self.decay_length is not None:
            size = size * np.exp(-np.abs(points[:, 2] - self.level) / self.decay_length)
        if self.region is not None:
            size = size * self.region(points)
        if isinstance(self.polarisation, str):
            return size[:, None] * _rayleigh(number * np.maximum(self.level - points[:, 2], 0.0), heading)
        return size[:, None] * unit(self.polarisation)


def _rayleigh(depth: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Complex polarisation [V, 3] at depths in radians (wave number times depth)."""
    p, s = np.exp(-_DECAY_P * depth), np.exp(-_DECAY_S * depth)
    along = p - _MIX * s
    up = _DECAY_P * (s / _MIX - p)
    return 1j * along[:, None] * heading + up[:, None] * np.array([0.0, 0.0, 1.0])
