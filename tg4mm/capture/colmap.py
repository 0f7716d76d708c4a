"""Reader of a COLMAP folder (images/ and sparse/0/): a capture of one timestep."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tg4mm.capture.colmap_model import ColmapCamera, ColmapImage, ColmapModel, read_model
from tg4mm.capture.confine import image_path, inside
from tg4mm.capture.model import Capture
from tg4mm.capture.scene import read_scene
from tg4mm.capture.transforms import View, assemble, in_order
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.records import Record

LAYOUT = "a COLMAP folder (images/ and sparse/0/)"
IMAGES = "images"
# Where a model lies: COLMAP's mapper numbers its models, its undistorter does not.
MODELS = ("sparse/0", "sparse")
# Indices of the focal lengths and the principal point among the parameters; what follows bends the rays.
_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_TWO_FOCALS = ("PINHOLE", "OPENCV", "FULL_OPENCV")
REMEDY = "undistort the images first (colmap image_undistorter, or tg4mm sfm on the photographs)"


def recognises(root: Path) -> bool:
    """Whether there is a folder images/ and a model in sparse/0/ or sparse/."""
    return (root / IMAGES).is_dir() and _model_folder(root) is not None


def load(root: Path, split: str, alpha: int) -> Capture:
    """Every registered image as a capture with T = 1; the model's points are its points."""
    if alpha:
        raise CaptureError(f"{root}: is one timestep, which has no images magnified by {alpha}")
    folder = _model_folder(root)
    assert folder is not None  # `recognises` found it
    if split != "train":
        raise MissingSplitError(
            f"{folder}: a COLMAP folder has training images only: there is no {split!r} split"
        )
    model = read_model(inside(root, folder, "the COLMAP model"))
    if not model.images:
        raise CaptureError(f"{folder}: holds no registered image")
    views = in_order(root, [_view(root, model, image) for image in model.images])
    return assemble(root, split, views, read_scene(root, needs_fps=False), 1, model.points)


def _model_folder(root: Path) -> Path | None:
    for name in MODELS:
        if any((root / name / f"images{suffix}").is_file() for suffix in (".bin", ".txt")):
            return root / name
    return None


def _view(root: Path, model: ColmapModel, image: ColmapImage) -> View:
    where = f"{model.folder}: image {image.name!r}"
    path = image_path(root, root / IMAGES, image.name, where)
    if image.camera_id not in model.cameras:
        raise CaptureError(f"{where}: is of camera {image.camera_id}, which is not among the cameras")
    camera = model.cameras[image.camera_id]
    fl_x, fl_y, cx, cy = _intrinsics(f"{model.folder}: camera {image.camera_id}", camera)
    values = {"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}
    pose = np.linalg.inv(image.cam_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return View(path, 0, pose, Record(where, values), Record(str(model.folder), {}))


def _intrinsics(where: str, camera: ColmapCamera) -> tuple[float, float, float, float]:
    """Focal lengths and principal point, pixels. Raises CaptureError where the lens bends straight lines."""
    params = camera.params
    if camera.model in _ONE_FOCAL:
        values, rest = (params[0], params[0], params[1], params[2]), params[3:]
    elif camera.model in _TWO_FOCALS:
        values, rest = (params[0], params[1], params[2], params[3]), params[4:]
    else:
        raise CaptureError(f"{where} is {camera.model}; expected PINHOLE or SIMPLE_PINHOLE: {REMEDY}")
    if any(rest):
        bent = ", ".join(f"{x:.4g}" for x in rest)
        raise CaptureError(f"{where} is {camera.model} with distortion {bent}; expected 0: {REMEDY}")
    return values
