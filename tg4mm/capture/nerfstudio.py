"""Reader of a nerfstudio folder: one transforms.json, of one timestep or with a time for each frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tg4mm.capture.model import Capture, SurfacePoints
from tg4mm.capture.points import read_points
from tg4mm.capture.scene import read_scene
from tg4mm.capture.transforms import assemble, timed, views_of_frames
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.records import Record, read_record
from tg4mm.core.values import shown

LAYOUT = "a nerfstudio folder (transforms.json)"
FILE = "transforms.json"
# Lenses without a model of their own are pinholes; OPENCV is one where k1 … p2, checked with each frame, are 0.
PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")


def recognises(root: Path) -> bool:
    """Whether a transforms.json lies in the folder."""
    return (root / FILE).is_file()


def load(root: Path, split: str, alpha: int) -> Capture:
    """The split as a capture: of one timestep, or of as many as its frames have times.

    A split is the file's list train_filenames (test_…, val_…); where it has none at all, every frame is training.
    Points come from ply_file_path, else points3d.ply. Poses are taken as they are: not recentred, not rescaled.
    """
    if alpha:
        raise CaptureError(f"{root}: is in a layout that has no images magnified by {alpha}")
    file = read_record(root / FILE)
    frames = file.values.get("frames")
    if not isinstance(frames, list) or not frames:
        raise file.error("frames", "a list of frames")
    chosen = _of_split(file, frames, split)
    views = views_of_frames(root, root, file, chosen, 0)
    for view in views:
        _check_lens(view.frame, file)
    views, scene, n_timesteps = timed(views, read_scene(root, needs_fps=False))
    return assemble(root, split, views, scene, n_timesteps, _points(root, file))


def _of_split(file: Record, frames: list[Any], split: str) -> list[tuple[int, Any]]:
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


def _check_lens(frame: Record, file: Record) -> None:
    record = frame if frame.has("camera_model") else file
    if record.has("camera_model") and record.text("camera_model") not in PINHOLES:
        raise record.error("camera_model", f"{' or '.join(PINHOLES)}: undistort the images first")


def _points(root: Path, file: Record) -> SurfacePoints | None:
    if not file.has("ply_file_path"):
        return None
    name = file.text("ply_file_path")
    points = read_points(root, name)
    if points is None:
        raise CaptureError(f"{file.where}: ply_file_path is {name!r}, which does not exist")
    return points
