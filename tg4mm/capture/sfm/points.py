"""Points found by structure from motion, those of them that can be trusted, and a world for them and the cameras."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from tg4mm.capture.cameras import nearest_point_equations, optical_axes
from tg4mm.capture.model import SurfacePoints


@dataclass(frozen=True)
class SfmPoints(SurfacePoints):
    """Triangulated points, in the order in which they were found."""

    errors_px: np.ndarray  # [M] float32, mean reprojection error of each, pixels
    n_views: np.ndarray  # [M] int64, pictures in which each was found

    def __len__(self) -> int:
        """M, the number of points."""
        return len(self.xyz)

    def kept(self, keep: np.ndarray) -> "SfmPoints":
        """Return the points where `keep` [M] is true."""
        return SfmPoints(self.xyz[keep], self.rgb[keep], self.errors_px[keep], self.n_views[keep])


def points_of(reconstruction) -> SfmPoints:
    """All points of a pycolmap Reconstruction, by number."""
    points = [reconstruction.points3D[i] for i in sorted(reconstruction.points3D)]
    return SfmPoints(
        np.array([p.xyz for p in points], np.float32).reshape(-1, 3),
        np.array([p.color for p in points], np.uint8).reshape(-1, 3),
        np.array([p.error for p in points], np.float32),
        np.array([p.track.length() for p in points], np.int64),
    )


def outside_masks(
    xyz: np.ndarray, viewmats: np.ndarray, Ks: np.ndarray, masks: np.ndarray, slack: int = 2
) -> np.ndarray:
    """[M] bool: true for points that some picture shows as background.

    masks [V, H, W] bool, true on the object, here grown by `slack` pixels, since a feature lies on a pixel and a
    point does not. A point outside all pictures, or behind all cameras, counts as outside too.
    """
    height, width = masks.shape[1:]
    outside, seen = np.zeros(len(xyz), bool), np.zeros(len(xyz), bool)
    for viewmat, K, mask in zip(viewmats, Ks, masks, strict=True):
        cam = xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
        z = np.maximum(cam[:, 2], 1e-6)
        # clipped before the cast: a point close to the camera's plane lands beyond any integer
        column = np.clip(np.floor(K[0, 0] * cam[:, 0] / z + K[0, 2]), -1, width).astype(int)
        row = np.clip(np.floor(K[1, 1] * cam[:, 1] / z + K[1, 2]), -1, height).astype(int)
        inside = (cam[:, 2] > 1e-6) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        grown = binary_dilation(mask, iterations=slack) if slack else mask
        outside[inside] |= ~grown[row[inside], column[inside]]
        seen |= inside
    return outside | ~seen


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
