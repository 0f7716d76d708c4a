"""Pictures through a lens as pictures of a pinhole, all of one size, with their alpha and in 8 bits.

COLMAP chooses the pinhole. The pictures are resampled here, since COLMAP's own routine knows neither alpha nor one
size for several cameras, and works out the same map again for every frame; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from tg4mm.errors import CaptureError
from tg4mm.sfm.engine import colmap

SMALLEST_SHARE = 0.75  # of the largest picture that the smallest must have in either direction
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Lens:
    """How pictures of one camera become those of a pinhole."""

    K: np.ndarray  # [3, 3] of the pinhole, pixels
    size: tuple[int, int]  # width and height of the new pictures
    # [2, H, W] row and column (of pixel centres, from 0) to take, after averaging over `block`; None: as they are
    source: np.ndarray | None
    block: int = 1  # pixels along each side averaged first, where the new pictures are smaller
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))  # [3, 3] axes of the new camera from the old

    def viewmats(self, viewmats: np.ndarray) -> np.ndarray:
        """[…, 4, 4] world-to-camera of the pinhole, from that of the camera."""
        turn = np.eye(4)
        turn[:3, :3] = self.turn
        return turn @ viewmats

    def apply(self, image: np.ndarray) -> np.ndarray:
        """[h, w, 3 or 4] with straight alpha, 8 or 16 bits → [H, W, 3 or 4] uint8, bilinear on colour · alpha."""
        if self.source is None and image.dtype == np.uint8:
            return image
        pixels = image.astype(np.float32) / np.iinfo(image.dtype).max
        if self.source is not None:
            pixels = self._moved(pixels)
        return (np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8)

    def _moved(self, pixels: np.ndarray) -> np.ndarray:
        alpha = pixels[..., 3:]
        if pixels.shape[2] == 4:
            pixels = np.concatenate([pixels[..., :3] * alpha, alpha], axis=2)
        if self.block > 1:
            rows, columns = (n // self.block for n in pixels.shape[:2])
            pixels = pixels[: rows * self.block, : columns * self.block]
            pixels = pixels.reshape(rows, self.block, columns, self.block, -1).mean(axis=(1, 3))
        channels = [np.ascontiguousarray(pixels[..., k]) for k in range(pixels.shape[2])]
        moved = np.stack(
            [map_coordinates(channel, self.source, order=1, mode="nearest") for channel in channels], axis=-1
        )
        if moved.shape[2] == 4:
            moved[..., :3] /= np.maximum(moved[..., 3:], 1e-6)
        return moved


def lenses(cameras: dict[int, Any], fitted: Iterable[int] = ()) -> dict[int, Lens]:
    """A `Lens` for each pycolmap Camera, all with pictures of one size: the largest that all have.

    fitted: cameras whose pictures are scaled, cut and turned by 90° to the size of the others' instead of having a say
    in it. Raises CaptureError where the others' pictures differ so much that a common size would cut much away.
    """
    pinholes = {i: _pinhole(camera) for i, camera in cameras.items()}
    sizes = np.array([(p.width, p.height) for i, p in pinholes.items() if i not in set(fitted)])
    width, height = (int(x) for x in sizes.min(axis=0))
    if (sizes.min(axis=0) < SMALLEST_SHARE * sizes.max(axis=0)).any():
        shown = ", ".join(sorted({f"{w}×{h}" for w, h in sizes.tolist()}))
        raise CaptureError(
            f"cameras have pictures of {shown} pixels, which one dataset cannot hold: scale them alike"
        )
    return {
        i: _fitted(cameras[i], pinholes[i], width, height)
        if i in set(fitted)
        else _lens(cameras[i], _cut(pinholes[i], 1.0, width, height), width, height)
        for i in cameras
    }


def _pinhole(camera: Any) -> Any:
    """The pinhole that COLMAP chooses; it would cut a pixel off a camera that is one already."""
    c = colmap("undistortion")
    return camera if camera.is_undistorted() else c.undistort_camera(c.UndistortCameraOptions(), camera)


def _fitted(camera: Any, pinhole: Any, width: int, height: int) -> Lens:
    """The picture turned upright or lying as the others, scaled to cover their size, the rest cut off."""
    if (pinhole.width, pinhole.height) == (width, height):
        return _lens(camera, _cut(pinhole, 1.0, width, height), width, height)
    turned = (pinhole.width - pinhole.height) * (width - height) < 0
    w, h = (height, width) if turned else (width, height)
    scale = max(w / pinhole.width, h / pinhole.height)
    K = _cut(pinhole, scale, w, h)
    if turned:
        # across becomes down: u' = height − v, v' = u
        K = np.array([[K[1, 1], 0, h - K[1, 2]], [0, K[0, 0], K[0, 2]], [0, 0, 1]])
    return _lens(camera, K, width, height, int(1 / scale) if scale <= 0.5 else 1, turned)


def _cut(pinhole: Any, scale: float, width: int, height: int) -> np.ndarray:
    """K of the middle of the pinhole's picture, scaled and cut to width × height."""
    K = np.array(pinhole.calibration_matrix(), dtype=np.float64)
    K[:2] *= scale
    excess = (pinhole.width * scale - width, pinhole.height * scale - height)
    # whole pixels where nothing is scaled, so that a picture as it is stays as it is
    K[0, 2] -= excess[0] / 2 if scale != 1 else excess[0] // 2
    K[1, 2] -= excess[1] / 2 if scale != 1 else excess[1] // 2
    return K


def _lens(camera: Any, K: np.ndarray, width: int, height: int, block: int = 1, turned: bool = False) -> Lens:
    if not turned and camera.is_undistorted() and (camera.width, camera.height) == (width, height):
        return Lens(K, (width, height), None)
    turn = _QUARTER if turned else np.eye(3)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
    seen = np.asarray(camera.img_from_cam(rays.reshape(-1, 3) @ turn)).reshape(height, width, 2)
    source = np.stack([seen[..., 1], seen[..., 0]]) / block - 0.5
    return Lens(K, (width, height), source.astype(np.float32), block, turn)
