"""Pictures of a camera that turned a little about its own centre, from one rendering with a margin.

Such a turn maps the picture by a homography, whatever the depth. Interpolating the rendered pixels would blur
them, and more the farther a new pixel centre lies from an old one: a motion of its own. So the scene is rendered at
twice the resolution with a quarter of the samples, and a new pixel is the sum of fine ones under the part of the
camera's pixel filter that the fine pixels do not have yet. Cycles' Blackman-Harris filter of setting w is a window
2 w pixels wide; the variance of a window goes with the square of its width, and variances add up. So a window
of √(3² − 1.5²) pixels follows one of 1.5 (fine pixels) to give one of 3 (the setting 1.5 of plain pictures).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..cameras import Camera
from ..cameras.paths import rotation_matrix

FINENESS = 2  # fine pixels per pixel along an edge
FILTER_PX = 3.0  # full width of the filter of plain pictures (render.py: setting 1.5)
_WINDOW = math.sqrt(FILTER_PX**2 - (FILTER_PX / FINENESS) ** 2)  # pixels
_TAPS = math.ceil(0.5 * _WINDOW * FINENESS)  # fine pixels to either side
_BLACKMAN_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)


def fine_size(size: int, margin: int) -> int:
    """Edge of the fine picture, for pictures of `size` pixels with `margin` more on every side."""
    return FINENESS * (size + 2 * margin)


def fine_camera(camera: Camera, size: int, margin: int) -> Camera:
    """The camera whose picture has a margin all around; same pose, same focal length per pixel."""
    wider = (size + 2 * margin) / size
    angle = 2.0 * math.atan(math.tan(0.5 * camera.angle_x) * wider)
    return replace(camera, angle_x=angle, shift=(camera.shift[0] / wider, camera.shift[1] / wider))


def pixels_before(camera: Camera, size: int, vector: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Where the camera as it stands sees what it sees at `pixels` [..., 2] when turned by a rotation vector [3].

    The vector is in camera axes (x right, y up, z back), radians; pixel centres lie at +0.5.
    """
    focal, centre = camera.focal(size), np.array(camera.principal_point(size, size))
    x, y = np.moveaxis((pixels - centre) / focal, -1, 0)
    rays = np.stack([x, -y, -np.ones_like(x)], -1) @ rotation_matrix(vector).T
    return centre + focal * np.stack([rays[..., 0], -rays[..., 1]], -1) / -rays[..., 2:]


def frame(fine: np.ndarray, camera: Camera, size: int, margin: int, vector: np.ndarray) -> np.ndarray:
    """The picture [size, size, 4] of the camera turned by `vector` [3], from the fine one of `fine_camera`.

    Linear light, premultiplied, float32, as `fine` [F, F, 4] is. Raises ValueError if the margin is too small.
    """
    edge = fine_size(size, margin)
    if fine.shape != (edge, edge, 4):
        raise ValueError(f"the fine picture has shape {fine.shape}, expected {(edge, edge, 4)}")
    centres = np.arange(size) + 0.5
    places = np.stack(np.meshgrid(centres, centres), -1)
    sources = (pixels_before(camera, size, vector, places) + margin) * FINENESS - 0.5  # in fine pixels
    first = np.floor(sources).astype(int)
    if first.min() < _TAPS - 1 or first.max() + _TAPS >= edge:
        raise ValueError(f"a margin of {margin} pixels is too small for a turn by {vector.tolist()}")
    steps = np.arange(1 - _TAPS, 1 + _TAPS)
    weights = _window((sources - first)[..., None] - steps)  # [size, size, 2, K]
    weights /= weights.sum(-1, keepdims=True)
    total = np.zeros((size, size, 4))
    for i, down in enumerate(steps):
        for j, right in enumerate(steps):
            weight = weights[..., 1, i] * weights[..., 0, j]
            total += weight[..., None] * fine[first[..., 1] + down, first[..., 0] + right]
    return total.astype(np.float32)


def _window(offset: np.ndarray) -> np.ndarray:
    """The window at offsets in fine pixels."""
    phase = 2 * np.pi * (offset / (FINENESS * _WINDOW) + 0.5)
    a, b, c, d = _BLACKMAN_HARRIS
    value = a - b * np.cos(phase) + c * np.cos(2 * phase) - d * np.cos(3 * phase)
    return np.where(np.abs(offset) < 0.5 * FINENESS * _WINDOW, value, 0.0)
