"""Frames of a transforms JSON as views, views assembled as a `Capture`, and the reader of one NeRF-synthetic folder.

D-NeRF's folders, whose frames have times, are read like a NeRF-synthetic one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from tg4mm.capture.cameras import camera_ids, read_intrinsics, read_pose, world_to_camera
from tg4mm.capture.frames import MissingPictureError, frame_of, image_path, inside, picture_header, portable
from tg4mm.capture.model import Capture, SurfacePoints, check_times, times_of_timesteps
from tg4mm.capture.planes import say_once
from tg4mm.capture.points import read_points
from tg4mm.capture.scene import SceneDescription
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.files import argument
from tg4mm.core.pictures.decode import THREADS
from tg4mm.core.untrusted import JsonRecord, read_record
from tg4mm.core.values import shown

if TYPE_CHECKING:
    from tg4mm.capture.sfm.undistort import Lens
from tg4mm.capture.scene import read_scene

T = TypeVar("T")
SPLITS = ("train", "test", "val")
UNEVEN = 0.1  # of a step, that a frame's time may be off its timestep
_TYPICAL = 90  # percentile of the differences of times: that of a step, where cameras film together
LAYOUT = "a NeRF-synthetic folder (transforms_train.json)"


@dataclass(frozen=True)
class TransformsFrame:
    """One frame of a transforms file, checked except for what needs the image's size."""

    path: Path
    timestep: int
    pose: np.ndarray  # [4, 4] camera-to-world, OpenGL axes
    frame: JsonRecord
    file: JsonRecord
    time_s: float = math.nan  # the frame's own time; NaN where it has none
    mask: Path | None = None  # white where it counts; None: everywhere
    # how its picture becomes a pinhole's, where it is none; then intrinsics are its own
    lens: Lens | None = None


def read_views(
    root: Path, folder: Path, split: str, timestep: int, may_miss: bool = False
) -> list[TransformsFrame]:
    """The frames of folder/transforms_<split>.json in order of file name.

    Raises CaptureError if the file is missing, empty or malformed, or a path or pose in it is unusable.
    """
    path = folder / f"transforms_{split}.json"
    if not inside(root, path, f"split {split!r}").is_file():
        raise MissingSplitError(f"{path}: does not exist: there is no {split!r} split")
    file = read_record(path)
    frames = file.values.get("frames")
    if not isinstance(frames, list):
        raise file.error("frames", "a list of frames")
    if not frames:
        raise CaptureError(f"{path}: frames is empty: the {split!r} split has no images")
    return views_of_frames(root, folder, file, list(enumerate(frames)), timestep, may_miss)


def views_of_frames(
    root: Path,
    folder: Path,
    file: JsonRecord,
    frames: list[tuple[int, Any]],
    timestep: int,
    may_miss: bool = False,
) -> list[TransformsFrame]:
    """Frames, each with its number in the file, as views in order of file name; paths are relative to `folder`.

    may_miss: less than half of the pictures may be missing, with a warning.

    Raises CaptureError if a frame is no object, its path or pose is unusable, or two show one image.
    """
    views: dict[Path, TransformsFrame] = {}

    def add(numbered: tuple[int, Any]) -> None:
        i, values = numbered
        if not isinstance(values, dict):
            raise CaptureError(f"{file.where}: frame {i} is {shown(values)}; expected an object {{…}}")
        frame = JsonRecord(f"{file.where}: frame {i}", values)
        image = image_path(root, folder, frame.text("file_path"), frame.where)
        if image in views:
            raise CaptureError(f"{frame.where}: image {image} is already that of another frame")
        time_s = frame.number("time") if frame.has("time") else math.nan
        views[image] = TransformsFrame(
            image, timestep, read_pose(frame), frame, file, time_s, _mask(root, folder, frame)
        )

    for_each_there(file.where, frames, add, may_miss)
    return in_order(views.values())


def for_each_there(where: str, named: Sequence[T], use: Callable[[T], object], may_miss: bool = True) -> None:
    """Call `use` with everything that names a picture, and say how many of these are missing.

    Raises MissingPictureError where no more than half are there, or none may be missing.
    """
    missing = []
    for one in named:
        try:
            use(one)
        except MissingPictureError as error:
            missing.append(error)
    if missing and (not may_miss or 2 * len(missing) >= len(named)):
        of = (
            ""
            if len(named) == 1 or not may_miss
            else f"; {len(missing)} of {len(named)} pictures are missing"
        )
        raise MissingPictureError(f"{missing[0]}{of}")
    if missing:
        say_once(Path(where), f"{len(missing)} of {len(named)} pictures are missing and left out")


def _mask(root: Path, folder: Path, frame: JsonRecord) -> Path | None:
    """The file that `mask_path` of a frame names. Raises CaptureError where it is not there or leaves the dataset."""
    if not frame.has("mask_path"):
        return None
    where = f"{frame.where}: mask_path"
    path = inside(root, folder / portable(folder, frame.text("mask_path")), where)
    if not path.is_file():
        raise CaptureError(f"{where} is {frame.text('mask_path')!r}, which does not exist")
    return path


def timed(
    views: list[TransformsFrame], scene: SceneDescription
) -> tuple[list[TransformsFrame], SceneDescription, int]:
    """Views of one file at the timesteps that their frames' times say, the scene with its frame rate, and T.

    Frames of one file that have several times, in seconds or as fractions of the record (D-NeRF), are of timesteps: the
    times in order; where these are no multiples of a step, as a phone's are, each is one, and the median step is the
    rate's. `time_s` of a frame, which `tg4mm convert` writes, is its time in seconds. The rate is scene.json's, else
    the file's `fps`. Raises CaptureError where there is none.
    """
    times = np.array([view.time_s for view in views])
    moments = np.unique(times[np.isfinite(times)])
    if len(moments) < 2:
        return views, scene, 1
    where, file = views[0].file.where, views[0].file
    fps = scene.fps or (file.number("fps", low=0.0) if file.has("fps") else 0.0)
    if not fps:
        raise CaptureError(
            f"{where}: its frames have {len(moments)} different times, but no rate is known: add "
            '"fps": <frames per second> to it'
        )
    places = (times - moments[0]) / float(np.diff(moments).min())
    times_s = np.full(len(views), math.nan)
    if np.nanmax(np.abs(places - np.round(places))) > UNEVEN:
        places, times_s = _uneven(times, moments, fps)
    known = [
        v.frame.number("time_s") if v.frame.has("time_s") else float(s)
        for v, s in zip(views, times_s, strict=True)
    ]
    timesteps = np.nan_to_num(np.round(places)).astype(int).tolist()
    views = [replace(v, timestep=t, time_s=s) for v, t, s in zip(views, timesteps, known, strict=True)]
    return views, replace(scene, fps=fps), max(timesteps) + 1


def _uneven(times: np.ndarray, moments: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Timesteps and seconds of times [C], of which `moments` are the different ones in order.

    Cameras that film together differ by less than half a step: that is one timestep.
    """
    steps = np.diff(moments)
    is_next = np.concatenate([[False], steps > np.percentile(steps, _TYPICAL) / 2])
    number = np.cumsum(is_next)
    first = moments[np.concatenate([[True], is_next[1:]])]
    seconds = (times - moments[0]) / float(np.median(np.diff(first))) / fps
    at = np.searchsorted(moments, np.nan_to_num(times, nan=moments[0]))
    return number[at].astype(float), seconds


def in_order(views: Iterable[TransformsFrame]) -> list[TransformsFrame]:
    """Views in natural order of their images' names; by the last part alone where some are frames of a video."""
    some = list(views)
    alone = any(frame_of(view.path) for view in some)
    return sorted(some, key=lambda view: natural(view.path.name if alone else view.path.as_posix()))


def natural(name: str) -> list[tuple[int, str]]:
    """Sort key under which r_2 comes before r_10."""
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"([0-9]+)", name)]


def assemble(
    root: Path,
    split: str,
    views: list[TransformsFrame],
    scene: SceneDescription,
    n_timesteps: int,
    points: SurfacePoints | None = None,
) -> Capture:
    """A `Capture` of these views; opens every image's header, since all must have one size.

    points: None takes points3d.ply, if it is there.
    """
    with ThreadPoolExecutor(THREADS) as pool:
        sizes = [(h.width, h.height) for h in pool.map(picture_header, [view.path for view in views])]
    for k, view in enumerate(views):
        if view.lens is not None:
            sizes[k] = view.lens.checked(view.path, sizes[k]).size
    for view, size in zip(views, sizes, strict=True):
        if size != sizes[0]:
            first = f"{views[0].path} is {sizes[0][0]}×{sizes[0][1]}"
            raise CaptureError(f"{view.path}: is {size[0]}×{size[1]} pixels, but {first}")
    width, height = sizes[0]
    times_s = _times(root, views, scene.fps, n_timesteps)
    viewmats = world_to_camera(np.stack([view.pose for view in views]))
    Ks = np.stack(
        [read_intrinsics(v.frame, v.file, width, height) if v.lens is None else v.lens.K for v in views]
    )
    return Capture(
        root=root,
        split=split,
        width=width,
        height=height,
        fps=scene.fps,
        n_timesteps=n_timesteps,
        viewmats=viewmats,
        Ks=Ks,
        timesteps=np.array([view.timestep for view in views], dtype=np.int64),
        camera_ids=camera_ids(viewmats, Ks),
        paths=tuple(view.path for view in views),
        masks=tuple(view.mask for view in views) if any(view.mask for view in views) else (),
        lenses=tuple(view.lens for view in views) if any(view.lens for view in views) else (),
        unit_scale_m=scene.unit_scale_m,
        points=read_points(root) if points is None else points,
        scene=scene.values,
        kind=scene.kind,  # type: ignore[arg-type]  # None: it follows from the cameras
        clocks=scene.clocks,
        readout_s=scene.readout_s,
        times_s=times_s,
    )


def _times(root: Path, views: list[TransformsFrame], fps: float, n_timesteps: int) -> np.ndarray:
    """The frames' own times [C], t / fps where none has any. Raises CaptureError where they contradict fps."""
    times_s = np.array([view.time_s for view in views])
    if np.isnan(times_s).all():
        return times_of_timesteps(np.array([view.timestep for view in views]), fps)
    for view in views:
        if math.isnan(view.time_s) and view.timestep > 0:
            raise CaptureError(f"{view.path}: its frame has no time, though others have")
    if n_timesteps > 1:
        cameras = [view.path.stem for view in views]  # a camera's pictures bear one name in all timesteps
        timesteps = np.array([view.timestep for view in views])
        check_times(str(root / "scene.json"), times_s, timesteps, cameras, fps)
    return times_s


def whole_dataset(folder: Path) -> tuple[Path, str] | None:
    """Return the dataset around `folder` and the folder's part in it, for a message; None for any other folder.

    Paths are absolute: what is meant is often the current folder.
    """
    folder = folder.resolve()
    if _is_timestep(folder):
        return folder.parent, f"timestep {folder.name} of the dataset {folder.parent}"
    if folder.name not in SPLITS or not (folder.parent / f"transforms_{folder.name}.json").is_file():
        return None
    if _is_timestep(folder.parent):
        root, moment = folder.parent.parent, f", timestep {folder.parent.name},"
    else:
        root, moment = folder.parent, ""
    return root, f"the {folder.name} pictures{moment} of the dataset {root}"


def train_command(root: Path) -> str:
    """The command line that trains a dataset."""
    return f"tg4mm train {argument(root)} --out RUN"


def _is_timestep(folder: Path) -> bool:
    has_frames = any((folder / f"transforms_{split}.json").is_file() for split in SPLITS)
    return folder.name.isdecimal() and has_frames and (folder.parent / "scene.json").is_file()


def recognises(root: Path) -> bool:
    """Return whether the folder has a transforms_<split>.json."""
    return any((root / f"transforms_{split}.json").is_file() for split in SPLITS)


def load(root: Path, split: str, alpha: int) -> Capture:
    """The folder's split as a capture; fps and scale are known only if a scene.json says them.

    Of one timestep, or of as many as its frames have times (D-NeRF), unless it is itself a timestep of a dataset.
    """
    if alpha:
        raise CaptureError(
            f"{root}: is a single timestep without magnified ground truth, so α = {alpha} is not available: use α = 0"
        )
    views, scene = read_views(root, root, split, 0, may_miss=True), read_scene(root, needs_fps=False)
    n_timesteps = 1
    if whole_dataset(root) is None:
        views, scene, n_timesteps = timed(views, scene)
    return assemble(root, split, views, scene, n_timesteps)
