"""Pictures through a lens as pictures of a pinhole, all of one size, with their alpha and in 8 bits."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from tg4mm.capture.sfm.engine import colmap
from tg4mm.core.errors import CaptureError

SMALLEST_SHARE = 0.75  # of the largest picture that the smallest must have in either direction
# Axes of a camera turned by 90° counterclockwise, as np.rot90 turns a picture: right was down, down was left.
_QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
Key = tuple[int, int]  # number of a camera, and quarter turns counterclockwise of its pictures


@dataclass(frozen=True)
class Lens:
    """The mapping from one camera's pictures to a pinhole's."""

    K: np.ndarray  # [3, 3] of the pinhole, pixels
    size: tuple[int, int]  # width and height of the new pictures
    # [2, H, W] row and column (of pixel centres, from 0) to take, after averaging over `block`; None: as they are
    source: np.ndarray | None
    turns: int = 0  # quarter turns counterclockwise, that the pinhole's picture is turned by
    block: int = 1  # pixels along each side averaged first, where the new pictures are smaller
    taken_of: tuple[int, int] | None = None  # width and height of the camera's own pictures

    @property
    def keeps(self) -> bool:
        """Return whether pictures are unchanged."""
        return self.source is None and self.turns % 4 == 0

    def checked(self, path: Path, size: tuple[int, int]) -> "Lens":
        """Return itself. Raises CaptureError for a picture of another size (width, height) than the camera's."""
        if self.taken_of is not None and size != self.taken_of:
            raise CaptureError(
                f"{path}: is {size[0]}×{size[1]} pixels, but its camera's pictures are "
                f"{self.taken_of[0]}×{self.taken_of[1]}"
            )
        return self

    def viewmat(self, viewmat: np.ndarray) -> np.ndarray:
        """Return [4, 4] world-to-camera of the pinhole, from that of the camera."""
        return quarter_turned(viewmat, self.turns)

    def apply(self, image: np.ndarray) -> np.ndarray:
        """Undistort [h, w, 3 or 4] of 8 or 16 bits to [H, W, 3 or 4] uint8, bilinearly on colour · alpha."""
        if self.source is None and image.dtype == np.uint8:
            return np.ascontiguousarray(np.rot90(image, self.turns))
        pixels = image.astype(np.float32) / np.iinfo(image.dtype).max
        pixels = np.rot90(pixels, self.turns) if self.source is None else self._moved(pixels)
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


def quarter_turned(viewmat: np.ndarray, turns: int) -> np.ndarray:
    """Return [4, 4] world-to-camera of the same camera, its picture turned counterclockwise by so many times 90°."""
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.matrix_power(_QUARTER, turns % 4)
    return turn @ viewmat


def lenses(cameras: Mapping[Key, Any], fitted: Iterable[Key] = ()) -> dict[Key, Lens]:
    """A `Lens` for each pycolmap Camera and turn of its pictures, all of one size: the largest that all have.

    fitted: cameras whose pictures are scaled and cut to the size of the others' instead of having a say in it.
    Raises CaptureError where the others' pictures differ so much that a common size would cut much away.
    """
    pinholes = {key: _pinhole(camera, key[1]) for key, camera in cameras.items()}
    sizes = np.array([pinhole.size for key, pinhole in pinholes.items() if key not in set(fitted)])
    width, height = (int(x) for x in sizes.min(axis=0))
    if (sizes.min(axis=0) < SMALLEST_SHARE * sizes.max(axis=0)).any():
        shown = ", ".join(sorted({f"{w}×{h}" for w, h in sizes.tolist()}))
        raise CaptureError(
            f"cameras have pictures of {shown} pixels, which do not fit into one dataset: scale them to one size"
        )
    return {
        key: _lens(camera, key[1], pinholes[key].cut(width, height, key in set(fitted)), (width, height))
        for key, camera in cameras.items()
    }


@dataclass(frozen=True)
class _Pinhole:
    """A pinhole's turned picture, and by how much it is scaled."""

    K: np.ndarray  # [3, 3] pixels
    size: tuple[int, int]  # width and height
    scale: float = 1.0

    def cut(self, width: int, height: int, may_scale: bool) -> "_Pinhole":
        """The middle of the picture; scaled first, if it may be, to cover that size."""
        scale = max(width / self.size[0], height / self.size[1]) if may_scale else 1.0
        K = self.K.copy()
        K[:2] *= scale
        for axis, (n, wanted) in enumerate(zip(self.size, (width, height), strict=True)):
            excess = n * scale - wanted
            # whole pixels where nothing is scaled, so that a picture as it is stays as it is
            K[axis, 2] -= excess // 2 if scale == 1 else excess / 2
        return _Pinhole(K, (width, height), scale)


def _pinhole(camera: Any, turns: int) -> _Pinhole:
    """The pinhole that COLMAP chooses, turned; it would cut a pixel off a camera that is one already."""
    c = colmap("undistortion")
    if not _is_pinhole(camera):
        camera = c.undistort_camera(c.UndistortCameraOptions(), camera)
    K, (w, h) = np.array(camera.calibration_matrix(), dtype=np.float64), (camera.width, camera.height)
    for _ in range(turns % 4):
        K = np.array([[K[1, 1], 0, K[1, 2]], [0, K[0, 0], w - K[0, 2]], [0, 0, 1]])
        w, h = h, w
    return _Pinhole(K, (w, h))


def _is_pinhole(camera: Any) -> bool:
    """A fisheye's coefficients of 0 leave it a fisheye, which COLMAP takes for undistorted."""
    return bool(camera.is_undistorted()) and "FISHEYE" not in camera.model.name


def _lens(camera: Any, turns: int, pinhole: _Pinhole, size: tuple[int, int]) -> Lens:
    K, (width, height) = pinhole.K, size
    turned = (camera.height, camera.width) if turns % 2 else (camera.width, camera.height)
    taken_of = camera.width, camera.height
    if _is_pinhole(camera) and turned == size:
        return Lens(K, size, None, turns, taken_of=taken_of)
    block = int(1 / pinhole.scale) if pinhole.scale <= 0.5 else 1
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
    unturned = rays.reshape(-1, 3) @ np.linalg.matrix_power(_QUARTER, turns % 4)
    seen = np.asarray(camera.img_from_cam(unturned)).reshape(height, width, 2)
    source = np.stack([seen[..., 1], seen[..., 0]]) / block - 0.5
    return Lens(K, size, source.astype(np.float32), turns, block, taken_of)
