"""What lies in the folder of pictures: photographs, one camera's video, or several fixed cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tg4mm.capture.confine import IMAGE_SUFFIXES
from tg4mm.capture.transforms import natural
from tg4mm.errors import CaptureError

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
SWEEP = "sweep"  # name of the folder or video of further pictures, which only help to find the poses
FEWEST = 3  # pictures from which poses can be found
LAYOUTS = (
    "expected pictures, one video, or for several fixed cameras a folder or a video each "
    f"(cam_00/0000.png …) and, if you like, {SWEEP}/"
)


@dataclass(frozen=True)
class Clip:
    """Pictures in order: those of a folder, or the frames of a video."""

    name: str
    path: Path  # folder or video
    pictures: tuple[Path, ...] = ()  # empty for a video until its frames are extracted

    @property
    def is_video(self) -> bool:
        return self.path.suffix.lower() in VIDEO_SUFFIXES and self.path.is_file()


@dataclass(frozen=True)
class Sources:
    """Either photographs (one clip, T = 1) or fixed cameras (a clip each, T frames), and perhaps a sweep."""

    fixed: bool
    clips: tuple[Clip, ...]
    sweep: Clip | None = None

    def every(self) -> tuple[Clip, ...]:
        """All clips, the sweep last."""
        return self.clips if self.sweep is None else (*self.clips, self.sweep)


def find_sources(path: Path) -> Sources:
    """What `path` holds. Raises CaptureError where it is missing, holds nothing usable, or mixes layouts."""
    if not path.exists():
        raise CaptureError(f"{path}: does not exist")
    if path.is_file():
        if path.suffix.lower() not in VIDEO_SUFFIXES:
            raise CaptureError(f"{path}: is neither a folder nor a video ({', '.join(VIDEO_SUFFIXES)})")
        return Sources(False, (Clip(path.stem, path),))
    pictures = _pictures(path)
    clips = [clip for clip in map(_clip, _entries(path)) if clip is not None]
    if pictures and any(clip.name != SWEEP for clip in clips):
        other = next(clip.name for clip in clips if clip.name != SWEEP)
        raise CaptureError(f"{path}: holds pictures and {other} beside them; {LAYOUTS}")
    sweep = next((clip for clip in clips if clip.name == SWEEP), None)
    if pictures:
        if sweep is not None:
            raise CaptureError(
                f"{path}: a {SWEEP} helps fixed cameras only; put its pictures beside the others"
            )
        if len(pictures) < FEWEST:
            raise CaptureError(f"{path}: holds {len(pictures)} pictures, at least {FEWEST} are needed")
        return Sources(False, (Clip(path.name, path, pictures),))
    cameras = tuple(clip for clip in clips if clip is not sweep)
    _check_names(path, cameras)
    return Sources(True, cameras, sweep)


def _check_names(path: Path, cameras: tuple[Clip, ...]) -> None:
    if not cameras:
        raise CaptureError(f"{path}: holds no pictures; {LAYOUTS}")
    if len(cameras) < 2:
        raise CaptureError(
            f"{path}: holds one fixed camera, {cameras[0].name}; at least 2 are needed, or pass {cameras[0].path}"
        )
    names = [camera.name for camera in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise CaptureError(f"{path}: camera {twice} is there twice")


def check_frames(sources: Sources) -> int:
    """T, the frames of each fixed camera. Raises CaptureError where they differ: cameras would not be in step."""
    counts = {clip.name: len(clip.pictures) for clip in sources.clips}
    first = next(iter(counts))
    for name, count in counts.items():
        if count != counts[first]:
            raise CaptureError(
                f"camera {name} has {count} frames, {first} has {counts[first]}: synchronised cameras have equally many"
            )
    return counts[first]


def _entries(path: Path) -> list[Path]:
    return sorted((p for p in path.iterdir() if not p.name.startswith(".")), key=lambda p: natural(p.name))


def _pictures(path: Path) -> tuple[Path, ...]:
    return tuple(p for p in _entries(path) if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file())


def _clip(path: Path) -> Clip | None:
    if path.is_dir():
        pictures = _pictures(path)
        return Clip(path.name, path, pictures) if pictures else None
    return Clip(path.stem, path) if path.suffix.lower() in VIDEO_SUFFIXES else None
