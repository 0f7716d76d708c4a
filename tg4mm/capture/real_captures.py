"""Readers of [3DMM]'s real captures: *tripod*, pictures that move about and then a video that stands; *handheld*.

    tripod      images/, sparse/0/ (COLMAP), video_frames_1/*   the video's frames in order of name are the timesteps;
                                                                the last picture of images/ shows the tripod's view
    handheld    images/, sparse/0/                              timestep i is picture dynamic_start − 1 + i, by name

The layouts hold no frame rate: scene.json beside them says `fps`, and of handheld ones `dynamic_start` (from 1).
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tg4mm.capture import colmap
from tg4mm.capture.frames import IMAGE_SUFFIXES, image_path, inside
from tg4mm.capture.model import Capture
from tg4mm.capture.scene import SceneDescription, read_scene
from tg4mm.capture.transforms import TransformsFrame, assemble, natural
from tg4mm.core.choices import Kind
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.untrusted import JsonRecord, read_record

LAYOUT = "a capture of 3DMM (images/, sparse/0/ and video_frames_1/, or dynamic_start in scene.json)"
FRAMES = "video_frames_1"
START = "dynamic_start"


def recognises(root: Path) -> bool:
    """Return whether a COLMAP folder has a tripod's frames beside it, or a scene.json with the motion's start."""
    if not colmap.recognises(root):
        return False
    return (root / FRAMES).is_dir() or (
        (root / "scene.json").is_file() and read_record(root / "scene.json").has(START)
    )


def load(root: Path, split: str, alpha: int) -> Capture:
    """The capture, with every other registered picture as one of the scene at rest, which has no time.

    Raises CaptureError for a frame or picture that is missing, and for a view of the tripod that is not registered.
    """
    if alpha:
        raise CaptureError(
            f"{root}: a real capture holds no magnified images, so α = {alpha} is not available: use α = 0"
        )
    if split != "train":
        raise MissingSplitError(
            f"{root}: a real capture has training images only: there is no {split!r} split"
        )
    if not (root / "scene.json").is_file():
        raise CaptureError(
            f'{root / "scene.json"}: does not exist; write {{"fps": 30}} there, with the frames\' own rate'
        )
    scene = read_scene(root, needs_fps=True)
    views, points = colmap.views_of(root)
    views = sorted(views, key=lambda view: natural(view.path.name))
    is_tripod = (root / FRAMES).is_dir()
    moving = _of_tripod(root, views) if is_tripod else _of_hand(root, views, scene)
    if scene.n_timesteps not in (None, len(moving)):
        raise CaptureError(
            f"{root / 'scene.json'}: n_timesteps is {scene.n_timesteps}, but there are {len(moving)} frames"
        )
    known = {view.path for view in moving} | ({views[-1].path} if is_tripod else set())
    timed = [replace(view, timestep=t, time_s=t / scene.fps) for t, view in enumerate(moving)]
    still = [view for view in views if view.path not in known]
    kind = scene.kind or (Kind.tripod if is_tripod else Kind.handheld)
    return assemble(
        root, split, [*timed[:1], *still, *timed[1:]], replace(scene, kind=kind), len(timed), points
    )


def _of_tripod(root: Path, views: list[TransformsFrame]) -> list[TransformsFrame]:
    """The frames, each with the pose and lens of the last picture."""
    names = _pictures(root / colmap.IMAGES)
    if not names or views[-1].path != names[-1]:
        last = names[-1].name if names else "its last picture"
        raise CaptureError(
            f"{root / colmap.IMAGES}: {last} shows the tripod's view, but is not registered in {colmap.FOLDERS[0]}: "
            "the tripod's pose is unknown"
        )
    frames = _pictures(root / FRAMES)
    if not frames:
        raise CaptureError(f"{root / FRAMES}: holds no pictures")
    _check_complete(frames)
    where = str(root / FRAMES)
    found = []
    for frame in frames:
        path = image_path(root, root / FRAMES, frame.name, where)
        found.append(replace(views[-1], path=path, mask=_mask(root, frame) or views[-1].mask))
    return found


def _of_hand(root: Path, views: list[TransformsFrame], scene: SceneDescription) -> list[TransformsFrame]:
    """The pictures from the start on, all of which are registered."""
    record = JsonRecord(str(root / "scene.json"), scene.values)
    first = record.whole(START, 1) - 1
    names = _pictures(root / colmap.IMAGES)
    count = scene.n_timesteps or len(names) - first
    wanted = names[first : first + count]
    if len(wanted) < max(count, 1):
        raise record.error(
            START, f"a picture's number, 1 to {len(names)}, with {scene.n_timesteps or 1} from there on"
        )
    _check_complete(wanted)
    of = {view.path: view for view in views}
    for path in wanted:
        if path not in of:
            raise CaptureError(
                f"{path}: is a timestep, but is not registered in {colmap.FOLDERS[0]}: its pose is unknown"
            )
    return [of[path] for path in wanted]


def _mask(root: Path, frame: Path) -> Path | None:
    """masks/video_frames_1/<name>.png, of one frame of a tripod; without it that of its view counts."""
    named = root / colmap.MASKS / FRAMES / f"{frame.name}.png"
    return inside(root, named, str(root)) if named.is_file() else None


def _pictures(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    return sorted((inside(folder, path, "picture") for path in found), key=lambda path: natural(path.name))


def _check_complete(frames: Sequence[Path]) -> None:
    """Raise CaptureError where the numbers at the ends of their names leave one out."""
    numbers = [re.search(r"([0-9]+)$", path.stem) for path in frames]
    known = [int(match[1]) for match in numbers if match]
    if len(known) < len(frames):
        return
    for path, number, following in zip(frames, known, known[1:], strict=False):
        if following != number + 1:
            raise CaptureError(f"{path.parent}: frame {number + 1} is missing, after {path.name}")
