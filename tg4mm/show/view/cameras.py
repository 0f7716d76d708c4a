"""Cameras of the capture and of the browser: from one to the other."""

import math
from dataclasses import dataclass

import numpy as np

from tg4mm.show.render.cameras import Camera, look_at


@dataclass(frozen=True)
class Standpoint:
    """A camera as the browser has it; world axes, scene units."""

    position: np.ndarray  # [3]
    target: np.ndarray  # [3] a point on the axis, which the mouse turns around
    up: np.ndarray  # [3] unit vector
    fov: float  # radians, from top to bottom


def standpoint_of(camera: Camera, depth: float, aspect: float) -> Standpoint:
    """Return the browser camera that sees all that `camera` sees, on a canvas of width / height `aspect`.

    `depth` (scene units) along its axis is the point to turn around.
    """
    half_height = camera.height / 2 / camera.K[1, 1]
    half_width = camera.width / 2 / camera.K[0, 0]
    fov = 2 * math.atan(max(half_height, half_width / aspect))
    return Standpoint(camera.position, camera.position + depth * camera.forward, -camera.viewmat[1, :3], fov)


def camera_of(
    position: np.ndarray, rotation: np.ndarray, fov: float, aspect: float, size: tuple[int, int]
) -> Camera:
    """The camera of a canvas for a picture of `size` (width, height), pixels.

    position [3] and rotation [3, 3] (camera to world, OpenCV axes); `fov` radians from top to bottom; `aspect` the
    canvas' width / height, which a size in whole pixels has only nearly.
    """
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.T
    viewmat[:3, 3] = -rotation.T @ position
    width, height = size
    tangent = math.tan(fov / 2)
    focal = width / 2 / (tangent * aspect), height / 2 / tangent
    K = np.array([[focal[0], 0, width / 2], [0, focal[1], height / 2], [0, 0, 1.0]])
    return Camera("view", viewmat, K, width, height)


def overview(means: np.ndarray, size: int = 768) -> Camera:
    """A camera that sees the middle 90 % of points [N, 3] from the side, where there is none of a capture."""
    low, high = np.quantile(means, 0.05, axis=0), np.quantile(means, 0.95, axis=0)
    centre = (low + high) / 2
    radius = max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    focal = 1.2 * size
    position = centre + 3.0 * radius * np.array([0.0, -0.94, 0.34])
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    return Camera("overview", look_at(position, centre), K, size, size)
