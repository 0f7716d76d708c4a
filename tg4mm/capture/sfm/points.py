"""Points found by structure from motion, and those of them that can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from tg4mm.capture.model import SurfacePoints


@dataclass(frozen=True)
class SfmPoints(SurfacePoints):
    """Triangulated points, in the order in which they were found."""

    errors_px: np.ndarray  # [M] float32, mean reprojection error of each, pixels
    n_views: np.ndarray  # [M] int64, pictures in which each was found

    def __len__(self) -> int:
        """M, the number of points."""
        return len(self.xyz)

    def kept(self, keep: np.ndarray) -> SfmPoints:
        """Those where `keep` [M] is true."""
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
