"""Small vector helpers that the displacement fields share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def unit(direction: Sequence[float] | np.ndarray) -> np.ndarray:
    """[3] float64 of length 1. The direction must not be zero."""
    d = np.asarray(direction, np.float64)
    d = d / np.abs(d).max()
    return np.asarray(d / np.linalg.norm(d))


def across(direction: Sequence[float] | np.ndarray, axis: np.ndarray, what: str) -> np.ndarray:
    """The unit vector [3] of what `direction` has perpendicular to the unit vector `axis`.

    Raises ValueError, beginning with `what`, if the two are parallel.
    """
    d = unit(direction)
    d = d - axis * (d @ axis)
    if np.linalg.norm(d) < 1e-6:
        raise ValueError(f"{what} {tuple(float(c) for c in direction)} is parallel to it")
    return unit(d)


def plane(
    normal: Sequence[float], x: Sequence[float] | None, what: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (u, v, n) of a plane: n the normal, u along `x` as far as it lies in the plane.

    Without `x`, u is along world x, or along world y if the normal is nearly along x. Raises ValueError,
    beginning with `what`, if x is parallel to the normal.
    """
    n = unit(normal)
    if x is None:
        x = (1.0, 0.0, 0.0) if abs(n[0]) < 0.9 else (0.0, 1.0, 0.0)
    u = across(x, n, what)
    return u, np.cross(n, u), n


def fade(distance: np.ndarray, full: float, zero: float) -> np.ndarray:
    """1 up to the distance `full`, exactly 0 from `zero` on, a smooth step (C¹) in between."""
    u = np.clip((zero - np.asarray(distance, np.float64)) / (zero - full), 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def phasor(degrees: float | np.ndarray) -> np.ndarray:
    """exp(i · degrees), exact at multiples of 90°, so that a real shape stays real."""
    quarters = np.asarray(degrees, np.float64) / 90.0
    whole = np.round(quarters)
    rest = np.exp(0.5j * np.pi * (quarters - whole))
    return np.asarray(np.array([1, 1j, -1, -1j])[whole.astype(int) % 4] * rest)
