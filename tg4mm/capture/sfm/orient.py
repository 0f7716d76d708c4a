"""A world for poses that have none: Z up, the scene in the middle, the cameras about four units away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tg4mm.capture.geometry import nearest_point_equations, optical_axes

DISTANCE = 4.0  # scene units, mean distance of the cameras from the middle, NeRF-synthetic's


@dataclass(frozen=True)
class Similarity:
    """x ↦ scale · rotation (x − centre)."""

    rotation: np.ndarray  # [3, 3]
    scale: float
    centre: np.ndarray  # [3]

    def points(self, xyz: np.ndarray) -> np.ndarray:
        """[M, 3] points moved."""
        return self.scale * (xyz - self.centre) @ self.rotation.T

    def viewmats(self, viewmats: np.ndarray) -> np.ndarray:
        """[C, 4, 4] world-to-camera of the same cameras in the new world, lengths in new units."""
        moved = np.tile(np.eye(4), (len(viewmats), 1, 1))
        moved[:, :3, :3] = viewmats[:, :3, :3] @ self.rotation.T
        moved[:, :3, 3] = self.scale * (viewmats[:, :3, 3] + viewmats[:, :3, :3] @ self.centre)
        return moved


def world_of(viewmats: np.ndarray, xyz: np.ndarray) -> Similarity:
    """The similarity that brings cameras viewmats [C, 4, 4] and points [M, 3] to a world of the usual kind.

    Up is what the pictures' rows are level to. The middle is the point nearest to all optical axes, or that of the
    points where the axes do not meet before the cameras. Then the first camera looks along +y, seen from above.
    """
    up = up_axis(viewmats)
    centres, axes = optical_axes(viewmats)
    ahead = axes[0] - (axes[0] @ up) * up
    if np.linalg.norm(ahead) < 1e-3:  # straight down: the top of the picture is ahead
        ahead = -viewmats[0, 1, :3] + (viewmats[0, 1, :3] @ up) * up
    ahead /= np.linalg.norm(ahead)
    rotation = np.stack([np.cross(ahead, up), ahead, up])
    middle = _middle(centres, axes, xyz)
    distance = float(np.linalg.norm(centres - middle, axis=1).mean())
    return Similarity(rotation, DISTANCE / max(distance, 1e-12), middle)


def up_axis(viewmats: np.ndarray) -> np.ndarray:
    """[3] unit vector: across to the cameras' horizontal axes (least squares), on the side of their mean up.

    Pictures are mostly taken level, so their rows are horizontal, however far the cameras look down. Where all rows
    point one way (cameras side by side), across is undetermined: then it is the mean up itself.
    """
    mean_up = -viewmats[:, 1, :3].mean(axis=0)
    _, size, directions = np.linalg.svd(viewmats[:, 0, :3])
    up = directions[2] * np.sign(directions[2] @ mean_up or 1.0)
    length = np.linalg.norm(mean_up)
    if size[1] < 0.1 * size[0] or (len(size) > 2 and size[2] > 0.5 * size[1]) or up @ mean_up < 0.3 * length:
        return mean_up / max(length, 1e-12) if length > 1e-6 else up
    return up


def _middle(centres: np.ndarray, axes: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    A, b = nearest_point_equations(centres, axes)
    if np.linalg.cond(A) < 1e3:
        middle = np.linalg.solve(A, b)
        if ((middle - centres) * axes).sum(axis=1).min() > 0:
            return middle
    return np.median(xyz, axis=0) if len(xyz) else centres.mean(axis=0) + axes.mean(axis=0)
