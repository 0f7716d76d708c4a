"""Bending of a slender part: the modes of an Euler–Bernoulli beam clamped at one end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from .fields import Field
from .geometry import across, unit
from .values import Direction, Point, whole

# Roots β of cosh β cos β = −1, the frequency equation of the clamped-free beam.
_BETA = (1.8751040687119611, 4.694091132974175, 7.854757438237613)


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
        """Of the beam, scene units."""
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
