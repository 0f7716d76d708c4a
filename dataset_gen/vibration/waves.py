"""Travelling waves: complex fields whose phase falls in the direction of travel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from .fields import Field
from .geometry import fade, unit
from .values import Direction, MaybePositive, Positive, Real, Triple, direction, positive, shown, vector

# Rayleigh wave in a solid of Poisson's ratio 1/4: (c/c_shear)² is a root of ξ³ − 8ξ² + 56/3 ξ − 32/3.
_XI = 2.0 - 2.0 / np.sqrt(3.0)
_DECAY_P, _DECAY_S = float(np.sqrt(1.0 - _XI / 3.0)), float(np.sqrt(1.0 - _XI))  # per wave number
_MIX = 1.0 - 0.5 * _XI


@dataclass(frozen=True)
class Region:
    """A ball in which a field acts: fully within half its radius, fading smoothly to 0 at its radius."""

    centre: Triple
    radius: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - np.array(self.centre), axis=1)
        return fade(distance, 0.5 * self.radius, self.radius)


def _region(value: Any) -> Region:
    if not isinstance(value, dict) or set(value) != {"centre", "radius"}:
        raise ValueError(f"{shown(value)} is not of the form {{centre: [x, y, z], radius: r}}")
    return Region(vector(value["centre"]), positive(value["radius"]))


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
    region: Annotated[Region | None, _region] = None

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
