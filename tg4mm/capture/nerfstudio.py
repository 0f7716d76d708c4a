"""Reader of a nerfstudio folder: one transforms.json, of one timestep or with a time for each frame."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from tg4mm.capture.cameras import distortion_of, read_intrinsics
from tg4mm.capture.frames import picture_header, portable
from tg4mm.capture.model import Capture, SurfacePoints
from tg4mm.capture.points import read_points
from tg4mm.capture.scene import read_scene
from tg4mm.capture.transforms import TransformsFrame, assemble, timed, views_of_frames
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.untrusted import JsonRecord, read_record
from tg4mm.core.values import shown

LAYOUT = "a nerfstudio folder (transforms.json)"
FILE = "transforms.json"
# Lenses without a model of their own are OPENCV, a pinhole where k1 … p2 are 0.
PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
FISHEYE = "OPENCV_FISHEYE"
# COLMAP's camera models, the narrowest first, and the coefficients that each has, in its order.
_BENT = {
    "OPENCV": ("k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    FISHEYE: ("k1", "k2", "k3", "k4"),
}


def recognises(root: Path) -> bool:
    """Return whether the folder has a transforms.json."""
    return (root / FILE).is_file()


def load(root: Path, split: str, alpha: int) -> Capture:
    """The split as a capture: of one timestep, or of as many as its frames have times.

    A split is the file's list train_filenames (test_…, val_…); where it has none at all, every frame is training.
    Points come from ply_file_path, else points3d.ply. Poses are taken as they are: not recentred, not rescaled.
    """
    if alpha:
        raise CaptureError(
            f"{root}: this layout holds no magnified images, so α = {alpha} is not available: use α = 0"
        )
    file = read_record(root / FILE)
    frames = file.values.get("frames")
    if not isinstance(frames, list) or not frames:
        raise file.error("frames", "a list of frames")
    chosen = _of_split(file, frames, split)
    views = views_of_frames(root, root, file, chosen, 0, may_miss=True)
    views, scene, n_timesteps = timed(_through_lenses(views), read_scene(root, needs_fps=False))
    return assemble(root, split, views, scene, n_timesteps, _points(root, file))


def _of_split(file: JsonRecord, frames: list[Any], split: str) -> list[tuple[int, Any]]:
    """The split's frames with their numbers in the file."""
    keys = [key for key in ("train_filenames", "test_filenames", "val_filenames") if file.has(key)]
    key = f"{split}_filenames"
    if not keys and split == "train":
        return list(enumerate(frames))
    if key not in keys:
        raise MissingSplitError(f"{file.where}: has no {key}: there is no {split!r} split")
    names = file.values[key]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise file.error(key, "a list of file names")
    wanted = set(names)
    chosen = [
        (i, values)
        for i, values in enumerate(frames)
        if not isinstance(values, dict)
        or not isinstance(values.get("file_path"), str)
        or values["file_path"] in wanted
    ]
    missing = wanted - {str(values.get("file_path")) for _, values in chosen if isinstance(values, dict)}
    if missing:
        raise CaptureError(f"{file.where}: {key} names {shown(sorted(missing)[0])}, which no frame has")
    if not chosen:
        raise CaptureError(f"{file.where}: {key} is empty: the {split!r} split has no images")
    return chosen


def _through_lenses(views: list[TransformsFrame]) -> list[TransformsFrame]:
    """The views, with how their pictures become a pinhole's where a lens bends: pycolmap straightens them."""
    models = [_model_of(view) for view in views]
    if not any(model in _BENT for model in models):
        return views
    from tg4mm.capture.sfm.engine import colmap
    from tg4mm.capture.sfm.undistort import lenses

    cameras: dict[tuple[Any, ...], int] = {}
    rows = []
    for view, model in zip(views, models, strict=True):
        header = picture_header(view.path)
        K = read_intrinsics(view.frame, view.file, header.width, header.height, is_bent=True)
        bends = distortion_of(view.frame, view.file)
        params = (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *(bends.get(key, 0.0) for key in _BENT.get(model, ())))
        key = (model, header.width, header.height, *(float(x) for x in params))
        rows.append(cameras.setdefault(key, len(cameras)))
    c = colmap("undistortion")
    known = {
        (i, 0): c.Camera(model=model, width=width, height=height, params=list(params))
        for (model, width, height, *params), i in cameras.items()
    }
    found = lenses(known)
    return [replace(view, lens=found[i, 0]) for view, i in zip(views, rows, strict=True)]


def _model_of(view: TransformsFrame) -> str:
    """COLMAP's name of a view's camera model. Raises CaptureError for one that is neither a pinhole nor can be bent."""
    record = view.frame if view.frame.has("camera_model") else view.file
    name = record.text("camera_model") if record.has("camera_model") else PINHOLES[0]
    if name not in (*PINHOLES, FISHEYE):
        raise record.error("camera_model", f"{', '.join(PINHOLES)} or {FISHEYE}: undistort the images first")
    bends = set(distortion_of(view.frame, view.file))
    if name == FISHEYE:
        if unknown := bends - set(_BENT[FISHEYE]):
            raise record.error(sorted(unknown)[0], f"0: {FISHEYE} has k1 to k4")
        return FISHEYE
    return next(model for model, names in {"PINHOLE": (), **_BENT}.items() if bends <= set(names))


def _points(root: Path, file: JsonRecord) -> SurfacePoints | None:
    if not file.has("ply_file_path"):
        return None
    name = portable(root, file.text("ply_file_path"))
    points = read_points(root, name)
    if points is None:
        raise CaptureError(f"{file.where}: ply_file_path is {name!r}, which does not exist")
    return points
