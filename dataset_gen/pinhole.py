"""The pinhole: from world points to pixels, for cameras that are made and for those read back from files."""

from __future__ import annotations

import numpy as np

Intrinsics = tuple[float, float, float, float]  # fx, fy, cx, cy, pixels


def project(
    points: np.ndarray, camera_to_world: np.ndarray, intrinsics: Intrinsics
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [..., 2] and planar depth [...] of world points [..., 3]; depth ≤ 0 is behind the camera.

    Pose with OpenGL axes; the centre of pixel (column i, row j) lies at (i + 0.5, j + 0.5).
    """
    local = (points - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    depth = -local[..., 2]
    fx, fy, cx, cy = intrinsics
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.stack([fx * local[..., 0] / depth + cx, cy - fy * local[..., 1] / depth], -1)
    return pixels, depth


def unproject(depth: np.ndarray, camera_to_world: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """World points [H, W, 3] that pixel centres see at planar depths [H, W]."""
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    x = (np.arange(width) + 0.5 - cx) / fx
    y = (np.arange(height) + 0.5 - cy) / fy
    rays = np.stack(np.broadcast_arrays(x[None], -y[:, None], -1.0), -1)
    return depth[..., None] * rays @ camera_to_world[:3, :3].T + camera_to_world[:3, 3]
