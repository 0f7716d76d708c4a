"""Pictures through a lens as pictures of a pinhole, all of one size, with their alpha and in 8 bits.

COLMAP chooses the pinhole. The pictures are resampled here, since COLMAP's own routine knows neither alpha nor one
size for several cameras, and works out the same map again for every frame; a test compares the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from tg4mm.errors import CaptureError
from tg4mm.sfm.engine import colmap

SMALLEST_SHARE = 0.75  # of the largest picture that the smallest must have in either direction


@dataclass(frozen=True)
class Lens:
    """How pictures of one camera become those of a pinhole."""

    K: np.ndarray  # [3, 3] of the pinhole, pixels
    size: tuple[int, int]  # width and height of the new pictures
    source: (
        np.ndarray | None
    )  # [2, H, W] row and column (of pixel centres, from 0) to take; None: as they are

    def apply(self, image: np.ndarray) -> np.ndarray:
        """[h, w, 4] with straight alpha, 8 or 16 bits → [H, W, 4] uint8, bilinear on colour · alpha."""
        pixels = image.astype(np.float32) / np.iinfo(image.dtype).max
        if self.source is not None:
            alpha = pixels[..., 3:]
            flat = np.concatenate([pixels[..., :3] * alpha, alpha], axis=2)
            moved = [map_coordinates(flat[..., k], self.source, order=1, mode="nearest") for k in range(4)]
            pixels = np.stack(moved, axis=-1)
            pixels[..., :3] /= np.maximum(pixels[..., 3:], 1e-6)
        return (np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8)


def lenses(cameras: dict[int, Any]) -> dict[int, Lens]:
    """A `Lens` for each pycolmap Camera, all with pictures of one size: the largest that all have.

    Raises CaptureError where cameras' pictures differ so much that a common size would cut much away.
    """
    c = colmap("undistortion")
    pinholes = {i: c.undistort_camera(c.UndistortCameraOptions(), camera) for i, camera in cameras.items()}
    sizes = np.array([(p.width, p.height) for p in pinholes.values()])
    width, height = (int(x) for x in sizes.min(axis=0))
    if (sizes.min(axis=0) < SMALLEST_SHARE * sizes.max(axis=0)).any():
        shown = ", ".join(sorted({f"{w}×{h}" for w, h in sizes.tolist()}))
        raise CaptureError(
            f"cameras have pictures of {shown} pixels, which one dataset cannot hold: scale them alike"
        )
    return {i: _lens(cameras[i], pinholes[i], width, height) for i in cameras}


def _lens(camera: Any, pinhole: Any, width: int, height: int) -> Lens:
    left, top = (pinhole.width - width) // 2, (pinhole.height - height) // 2
    K = np.array(pinhole.calibration_matrix(), dtype=np.float64)
    K[0, 2] -= left
    K[1, 2] -= top
    if camera.is_undistorted() and (camera.width, camera.height) == (width, height):
        return Lens(K, (width, height), None)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
    seen = np.asarray(camera.img_from_cam(rays.reshape(-1, 3))).reshape(height, width, 2)
    return Lens(K, (width, height), np.stack([seen[..., 1] - 0.5, seen[..., 0] - 0.5]).astype(np.float32))
