"""Reader of a COLMAP folder (images/ and sparse/0/): a capture of one timestep."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from tg4mm.capture.cameras import check_near
from tg4mm.capture.frames import image_path, inside, portable
from tg4mm.capture.model import Capture, SurfacePoints
from tg4mm.capture.planes import say_once
from tg4mm.capture.scene import read_scene
from tg4mm.capture.transforms import TransformsFrame, assemble, for_each_there, in_order
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.splatfile.formula import rotation_matrices
from tg4mm.core.untrusted import JsonRecord

if TYPE_CHECKING:
    from tg4mm.capture.sfm.undistort import Lens

# COLMAP's numbers of its camera models, and how many parameters each has.
MODELS = dict(enumerate([
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8), ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16), ("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4),
    ("EUCM", 6), ("EQUIRECTANGULAR", 2),
]))  # fmt: skip
COUNTS = dict(MODELS.values())
T = TypeVar("T")
LAYOUT = "a COLMAP folder (images/ and sparse/0/)"
IMAGES, MASKS = "images", "masks"
# where a model lies: COLMAP's mapper numbers its models, its undistorter does not
FOLDERS = ("sparse/0", "sparse")
# and in other programs' folders, in the order in which they are looked at
_PLACES = ("sparse/*", "sparse", "sparse/*/*", "colmap/sparse/*", "colmap/sparse", "colmap", "")
# Indices of the focal lengths and the principal point among the parameters; what follows bends the rays.
_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_TWO_FOCALS = ("PINHOLE", "OPENCV", "FULL_OPENCV")
REMEDY = "undistort the images first (colmap image_undistorter, or tg4mm sfm on the photographs)"


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
    """Parts of a sparse model that a capture needs."""

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
    """Call the reader and convert its failures to CaptureError."""
    try:
        return reader(path)
    except CaptureError:
        raise
    except (ValueError, IndexError, struct.error, OverflowError, MemoryError) as error:
        text = " ".join(str(error).split())
        raise CaptureError(f"{path}: is truncated or damaged: {text}") from error


def _pose(where: str, quaternion: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return [4, 4] of COLMAP's (w, x, y, z) and translation; refuses values that are not finite, or no rotation."""
    norm = float(np.linalg.norm(quaternion))
    if not np.isfinite([norm, *translation]).all() or abs(norm - 1) > 1e-3:
        numbers = [round(float(x), 4) for x in (*quaternion, *translation)]
        raise CaptureError(f"{where}: has the pose {numbers}; expected a unit quaternion and a translation")
    pose = np.eye(4)
    pose[:3, :3] = rotation_matrices(quaternion[None] / norm)[0]
    pose[:3, 3] = translation
    return pose


def _surface(path: Path, xyz: np.ndarray, rgb: np.ndarray) -> SurfacePoints | None:
    if len(xyz) == 0:
        return None
    if not np.isfinite(xyz).all():
        raise CaptureError(f"{path}: holds a point that is not finite")
    return SurfacePoints(np.ascontiguousarray(xyz, np.float64), np.ascontiguousarray(rgb, np.uint8))


class _Bytes:
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
    for line in path.read_text(encoding="utf-8-sig").splitlines():
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


def recognises(root: Path) -> bool:
    """Return whether there is a folder images/ and a model in sparse/0/ or sparse/."""
    return (root / IMAGES).is_dir() and _model_folder(root) is not None


def load(root: Path, split: str, alpha: int) -> Capture:
    """Every registered image as a capture with T = 1; the model's points are its points."""
    if alpha:
        raise CaptureError(
            f"{root}: is a single timestep without magnified ground truth, so α = {alpha} is not available: use α = 0"
        )
    if split != "train":
        raise MissingSplitError(
            f"{_model_folder(root)}: a COLMAP folder has training images only: there is no {split!r} split"
        )
    views, points = views_of(root)
    return assemble(root, split, in_order(views), read_scene(root, needs_fps=False), 1, points)


def views_of(root: Path) -> tuple[list[TransformsFrame], SurfacePoints | None]:
    """Every registered image of the folder's model, without a time, and the model's points.

    A lens that bends straight lines is straightened by pycolmap, where pictures are decoded.
    """
    folder = _model_folder(root)
    assert folder is not None  # `recognises` found it
    model = read_model(inside(root, folder, "the COLMAP model"))
    if not model.images:
        raise CaptureError(f"{folder}: holds no registered image")
    used = {image.camera_id for image in model.images} & set(model.cameras)
    lenses = _lenses(model, used) if any(_bends(model.cameras[i]) for i in used) else {}
    views: list[TransformsFrame] = []
    for_each_there(str(folder), model.images, lambda image: views.append(_view(root, model, image, lenses)))
    return views, model.points


def _model_folder(root: Path) -> Path | None:
    """Return the model's folder; of several, which COLMAP makes if pictures do not connect, the largest."""
    found = (
        _numbered([f for f in (sorted(root.glob(p)) if p else [root]) if _images_file(f) is not None])
        for p in _PLACES
    )
    models = next(filter(None, found), [])
    if len(models) < 2:
        return models[0] if models else None
    counts = [_count(inside(root, folder, "the COLMAP model")) for folder in models]
    best = models[counts.index(max(counts))]
    listed = ", ".join(
        f"{f.name} ({max(n, 0) or 'damaged' * (n < 0) or 0})" for f, n in zip(models, counts, strict=True)
    )
    say_once(
        best.parent,
        f"holds {len(models)} models, with pictures: {listed}; the largest, {best.name}, is taken",
    )
    return best


def _numbered(models: list[Path]) -> list[Path]:
    """Return those with numbers as names, as COLMAP gives them, if there are any: others beside them are copies."""
    return sorted((f for f in models if f.name.isdigit()), key=lambda f: int(f.name)) or models


def _images_file(folder: Path) -> Path | None:
    files = (folder / f"images{suffix}" for suffix in (".bin", ".txt"))
    return next((file for file in files if file.is_file()), None)


def _count(folder: Path) -> int:
    """Return the number of pictures in a model; −1 where it is damaged."""
    try:
        return len(read_model(folder).images)
    except CaptureError:
        return -1


def _bends(camera: ColmapCamera) -> bool:
    if camera.model in _ONE_FOCAL:
        return any(camera.params[3:])
    return camera.model not in _TWO_FOCALS or any(camera.params[4:])


def _lenses(model: ColmapModel, used: set[int]) -> dict[int, Lens]:
    """Return each camera's mapping to a pinhole of one common size. Raises Tg4mmError without pycolmap."""
    from tg4mm.capture.sfm.engine import colmap
    from tg4mm.capture.sfm.undistort import lenses

    known = {}
    for i, camera in ((i, model.cameras[i]) for i in sorted(used)):
        try:
            known[i, 0] = colmap("undistortion").Camera(
                model=camera.model, width=camera.width, height=camera.height, params=list(camera.params)
            )
            known[i, 0].calibration_matrix()  # a panorama has none
        except (ValueError, RuntimeError) as error:
            raise CaptureError(
                f"{model.folder}: camera {i} is {camera.model}, of which pycolmap makes no pinhole: {REMEDY}"
            ) from error
    return {i: lens for (i, _), lens in lenses(known).items()}


def _view(root: Path, model: ColmapModel, image: ColmapImage, lenses: dict[int, Lens]) -> TransformsFrame:
    where = f"{model.folder}: image {image.name!r}"
    path = image_path(root, root / IMAGES, image.name, where)
    named = root / MASKS / f"{portable(root / IMAGES, image.name)}.png"  # as COLMAP's own extractor has it
    mask = inside(root, named, where) if named.is_file() else None
    if image.camera_id not in model.cameras:
        raise CaptureError(f"{where}: belongs to camera {image.camera_id}, which the model does not define")
    camera = model.cameras[image.camera_id]
    pose = np.linalg.inv(image.cam_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0])
    check_near(pose, f"{where}: its camera")
    if (lens := lenses.get(image.camera_id)) is not None:
        return TransformsFrame(
            path, 0, pose, JsonRecord(where, {}), JsonRecord(str(model.folder), {}), mask=mask, lens=lens
        )
    fl_x, fl_y, cx, cy = _intrinsics(camera)
    values = {"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}
    return TransformsFrame(
        path, 0, pose, JsonRecord(where, values), JsonRecord(str(model.folder), {}), mask=mask
    )


def _intrinsics(camera: ColmapCamera) -> tuple[float, float, float, float]:
    """Focal lengths and principal point of a pinhole, pixels."""
    params = camera.params
    if camera.model in _ONE_FOCAL:
        return params[0], params[0], params[1], params[2]
    return params[0], params[1], params[2], params[3]
