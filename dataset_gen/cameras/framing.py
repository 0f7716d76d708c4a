"""How far cameras have to stand so that nothing is cut off by the edge of a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .camera import Camera

_INSIDE = 0.96  # of the picture's half width: pixel filters, and a hand that shakes, need a little room
_STEP = 1.01
_MOST = 300  # steps, 20 times as far
_DIRECTIONS = 400


def farther(points: np.ndarray, cameras: Callable[[float], Sequence[Camera]]) -> float:
    """The least factor from 1 in steps of 1 % for which `cameras(factor)` have all `points` [P, 3] in their pictures.

    Pictures are square.
    """
    hull = extreme_points(points)
    clearance = 1.0
    for _ in range(_MOST):
        if all(half_widths(camera, hull) <= _INSIDE for camera in cameras(clearance)):
            break
        clearance *= _STEP
    return round(clearance, 6)


def half_widths(camera: Camera, points: np.ndarray) -> float:
    """How far off the picture's middle any of the points [P, 3] lands, in half widths of the square picture.

    Infinite if one lies behind the camera.
    """
    pixels, depth = camera.project(points, 2, 2)
    return float(np.abs(pixels - 1.0).max()) if (depth > 0).all() else float("inf")


def extreme_points(points: np.ndarray) -> np.ndarray:
    """Those of the points [P, 3] that lie farthest in one of 400 directions, evenly spread over the sphere."""
    return points[np.unique([int((points @ direction).argmax()) for direction in _directions()])]


def moving_points(points: np.ndarray, basis: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """[400, 3]: the farthest place that any of the points comes to at any time, in each of 400 directions.

    Parameters: `points` [P, 3] at rest; `basis` [G, P, 3], real shapes of their displacement; `gains` [G, T], of the
    shapes over time.
    """
    most = np.abs(gains).max(axis=1, initial=0.0)

    def farthest(direction: np.ndarray) -> np.ndarray:
        still, shapes = points @ direction, basis @ direction
        ends = most @ np.abs(shapes)
        may = np.flatnonzero(still + ends >= (still - ends).max())  # no other point can come first
        along = still[may, None] + shapes[:, may].T @ gains
        point, time = np.unravel_index(along.argmax(), along.shape)
        return points[may[point]] + gains[:, time] @ basis[:, may[point]]

    return np.array([farthest(direction) for direction in _directions()])


def _directions() -> np.ndarray:
    """[400, 3] unit vectors."""
    turns = np.arange(_DIRECTIONS) + 0.5
    z, azimuth = 1.0 - 2.0 * turns / _DIRECTIONS, turns * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
