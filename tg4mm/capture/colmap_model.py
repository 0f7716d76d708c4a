"""COLMAP's sparse model: cameras, images and points3D, .bin or .txt, read without COLMAP.

Layouts as COLMAP's documentation (format.html) gives them. Rigs and frames, which COLMAP 4 writes besides, say
nothing that images does not.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from tg4mm.capture.model import SurfacePoints
from tg4mm.core.errors import CaptureError

# COLMAP's numbers of its camera models, and how many parameters each has.
MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
}
COUNTS = dict(MODELS.values())
T = TypeVar("T")


@dataclass(frozen=True)
class ColmapCamera:
    """A camera as COLMAP has it."""

    model: str
    width: int  # pixels
    height: int  # pixels
    params: tuple[float, ...]


@dataclass(frozen=True)
class ColmapImage:
    """A registered image as COLMAP has it."""

    name: str  # relative to the folder of images, with /
    camera_id: int
    cam_from_world: np.ndarray  # [4, 4] float64, OpenCV axes


@dataclass(frozen=True)
class ColmapModel:
    """Everything of a sparse model that a capture needs."""

    folder: Path
    cameras: dict[int, ColmapCamera]
    images: tuple[ColmapImage, ...]
    points: SurfacePoints | None  # None if there are none


def read_model(folder: Path) -> ColmapModel:
    """The model in `folder`, binary where both are there. Raises CaptureError for a missing or damaged file."""
    suffix = ".bin" if (folder / "images.bin").is_file() else ".txt"
    paths = [folder / f"{name}{suffix}" for name in ("cameras", "images", "points3D")]
    for path in paths[:2]:
        if not path.is_file():
            raise CaptureError(f"{path}: does not exist; a COLMAP model has cameras, images and points3D")
    readers = _BINARY if suffix == ".bin" else _TEXT
    cameras, images = _guarded(paths[0], readers[0]), _guarded(paths[1], readers[1])
    points = _guarded(paths[2], readers[2]) if paths[2].is_file() else None
    return ColmapModel(folder, cameras, images, points)


def _guarded(path: Path, reader: Callable[[Path], T]) -> T:
    """What the reader finds; CaptureError where it stumbles."""
    try:
        return reader(path)
    except CaptureError:
        raise
    except (ValueError, IndexError, struct.error, OverflowError, MemoryError) as error:
        text = " ".join(str(error).split())
        raise CaptureError(f"{path}: is truncated or damaged: {text}") from error


def _pose(where: str, quaternion: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """[4, 4] of COLMAP's (w, x, y, z) and translation; refuses what is not finite, and no rotation."""
    norm = float(np.linalg.norm(quaternion))
    if not np.isfinite([norm, *translation]).all() or abs(norm - 1) > 1e-3:
        numbers = [round(float(x), 4) for x in (*quaternion, *translation)]
        raise CaptureError(f"{where}: has the pose {numbers}; expected a unit quaternion and a translation")
    w, x, y, z = quaternion / norm
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = translation
    return pose


def _surface(path: Path, xyz: np.ndarray, rgb: np.ndarray) -> SurfacePoints | None:
    if len(xyz) == 0:
        return None
    if not np.isfinite(xyz).all():
        raise CaptureError(f"{path}: holds a point that is not finite")
    return SurfacePoints(np.ascontiguousarray(xyz, np.float32), np.ascontiguousarray(rgb, np.uint8))


class _Bytes:
    """A binary file read from front to back."""

    def __init__(self, path: Path) -> None:
        self.data, self.at = path.read_bytes(), 0

    def take(self, layout: str) -> tuple:
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += struct.calcsize("<" + layout)
        return values

    def text(self) -> str:
        end = self.data.index(b"\0", self.at)
        value = self.data[self.at : end].decode()
        self.at = end + 1
        return value

    def skip(self, n: int) -> None:
        self.at += n
        if self.at > len(self.data):
            raise ValueError(f"ends at byte {len(self.data)}, {self.at} expected")


def _cameras_bin(path: Path) -> dict[int, ColmapCamera]:
    file, cameras = _Bytes(path), {}
    for _ in range(file.take("Q")[0]):
        camera_id, model, width, height = file.take("iiQQ")
        if model not in MODELS:
            raise CaptureError(f"{path}: camera {camera_id} has the model number {model}, which is unknown")
        name, n = MODELS[model]
        cameras[camera_id] = ColmapCamera(name, width, height, file.take(f"{n}d"))
    return cameras


def _images_bin(path: Path) -> tuple[ColmapImage, ...]:
    file, images = _Bytes(path), []
    for _ in range(file.take("Q")[0]):
        image_id, *numbers, camera_id = file.take("i7di")
        name = file.text()
        file.skip(24 * file.take("Q")[0])  # x, y and the point's number of every feature
        pose = _pose(f"{path}: image {image_id}", np.array(numbers[:4]), np.array(numbers[4:]))
        images.append(ColmapImage(name, camera_id, pose))
    return tuple(images)


def _points_bin(path: Path) -> SurfacePoints | None:
    file, xyz, rgb = _Bytes(path), [], []
    for _ in range(file.take("Q")[0]):
        _, x, y, z, r, g, b, _, track = file.take("Q3d3BdQ")
        file.skip(8 * track)
        xyz.append((x, y, z))
        rgb.append((r, g, b))
    return _surface(path, np.array(xyz).reshape(-1, 3), np.array(rgb).reshape(-1, 3))


def _lines(path: Path) -> Iterator[list[str]]:
    """The lines of a text file as words, comments left out, empty lines kept (an image may have no features)."""
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            yield line.split()


def _cameras(path: Path) -> dict[int, ColmapCamera]:
    cameras = {}
    for words in filter(None, _lines(path)):
        model, params = words[1], tuple(float(word) for word in words[4:])
        if len(params) != COUNTS.get(model, len(params)):
            raise ValueError(f"camera {words[0]}, {model}, has {len(params)} parameters, not {COUNTS[model]}")
        cameras[int(words[0])] = ColmapCamera(model, int(words[2]), int(words[3]), params)
    return cameras


def _images(path: Path) -> tuple[ColmapImage, ...]:
    images, lines = [], list(_lines(path))
    for words in lines[0::2]:  # every second line lists features
        if not words:
            continue
        pose = _pose(f"{path}: image {words[0]}", np.array(words[1:5], float), np.array(words[5:8], float))
        images.append(ColmapImage(" ".join(words[9:]), int(words[8]), pose))
    return tuple(images)


def _points(path: Path) -> SurfacePoints | None:
    rows = [words for words in _lines(path) if words]
    xyz = np.array([words[1:4] for words in rows], float).reshape(-1, 3)
    rgb = np.array([words[4:7] for words in rows], float).reshape(-1, 3)
    return _surface(path, xyz, rgb)


_BINARY = (_cameras_bin, _images_bin, _points_bin)
_TEXT = (_cameras, _images, _points)
