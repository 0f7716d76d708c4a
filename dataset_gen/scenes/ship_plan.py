"""Dimensions of the ship that several of her parts share. Scene units; bow along +x, starboard at y < 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..shapes.hull import Hull

HULL = Hull()
WATER = -0.37  # level of the sea
WATER_RADIUS = 1.2

# Decks: stations from aft to fore, height above the sheer.
LEVELS: dict[str, tuple[tuple[float, float], float]] = {
    "waist": ((0.36, 0.73), -0.05),
    "quarterdeck": ((0.14, 0.37), 0.025),
    "poop": ((0.0, 0.15), 0.095),
    "forecastle": ((0.72, 0.985), 0.03),
}
# Bulwarks: stations, foot and head above the sheer.
BULWARKS: dict[str, tuple[tuple[float, float], float, float]] = {
    "waist": ((0.3705, 0.7195), 0.0, 0.03),
    "quarterdeck": ((0.0, 0.37), 0.0, 0.08),
    "poop": ((0.0, 0.15), 0.08, 0.15),
    "forecastle": ((0.72, 0.985), 0.0, 0.08),
}
# How far the inside of each bulwark reaches below its foot: to its deck.
LINING = {"waist": 0.06, "quarterdeck": 0.0, "poop": 0.0, "forecastle": 0.0}


@dataclass(frozen=True)
class MastPlan:
    """One mast: heights of its pole from the deck up, and its yards as (height, half length, furled sail radius)."""

    name: str
    x: float
    foot: float
    top: float  # the platform
    crosstrees: float
    head: float
    rake: float  # x per unit of height, aft is negative
    radius: float
    yards: tuple[tuple[float, float, float], ...]
    brace: float  # degrees the yards are turned

    def at(self, z: float, forward: float = 0.0) -> np.ndarray:
        """The mast's axis at a height."""
        return np.array([self.x + self.rake * (z - self.foot) + forward, 0.0, z])


FORE = MastPlan(
    "fore", 0.40, -0.09, 0.30, 0.60, 0.84, 0.03, 0.019,
    ((0.215, 0.30, 0.031), (0.50, 0.22, 0.026), (0.73, 0.14, 0.018)), 9.0,
)  # fmt: skip
MAIN = MastPlan(
    "main", -0.04, -0.24, 0.38, 0.74, 1.02, -0.02, 0.022,
    ((0.275, 0.35, 0.035), (0.62, 0.25, 0.029), (0.89, 0.16, 0.02)), 9.0,
)  # fmt: skip
MIZZEN = MastPlan(
    "mizzen", -0.47, -0.06, 0.30, 0.52, 0.68, -0.05, 0.016,
    ((0.225, 0.2, 0.0), (0.445, 0.16, 0.019)), 9.0,
)  # fmt: skip
MASTS = (FORE, MAIN, MIZZEN)
BOWSPRIT = (np.array([0.48, 0.0, -0.035]), np.array([1.10, 0.0, 0.225]))


def deck_z(name: str, u: float) -> float:
    """Height of a deck's edge at a station."""
    return float(HULL.sheer(np.array(u))) + LEVELS[name][1]


def deck_at(name: str, x: float, y: float = 0.0) -> np.ndarray:
    """A point on a deck's planks, camber included."""
    u = HULL.station(x, deck_z(name, 0.5))
    z = deck_z(name, u)
    half = max(float(HULL.breadth(np.array(u), z)) - 0.008, 1e-3)
    return np.array([x, y, z + 0.01 * (1.0 - min(abs(y) / half, 1.0) ** 2) * min(half / 0.1, 1.0)])
