"""The input on disk: photographs, one or several recordings, perhaps a sweep; and the command for it."""

from dataclasses import dataclass
from pathlib import Path

from tg4mm.capture.confine import IMAGE_SUFFIXES
from tg4mm.capture.sfm.clip import NAMES, Clip
from tg4mm.capture.stacks import PHOTRON_SUFFIXES
from tg4mm.capture.transforms import natural, train_command, whole_dataset
from tg4mm.capture.video import RECORDING_SUFFIXES, VIDEO_SUFFIXES
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import argument

SWEEP = "sweep"  # name of the folder or video of pictures of the scene at rest
FEWEST = 3  # pictures from which poses can be found
LAYOUTS = (
    "expected photographs, one video, or a video (or a folder of frames) for each fixed camera and, if you like, "
    f"{SWEEP}/ with pictures of the scene at rest"
)
# Recordings beside each other; a GIF among pictures is a preview, a TIFF one of them.
_IN_FOLDERS = tuple({*VIDEO_SUFFIXES, *PHOTRON_SUFFIXES} - {".gif"})
# Pictures that phones and cameras write and that are not read here.
UNREAD = (".heic", ".heif", ".dng", ".cr2", ".cr3", ".nef", ".arw")
# Files by which a dataset that `tg4mm train` reads is told from pictures.
DATASET = ("scene.json", "transforms*.json", "*/transforms_*.json", "sparse/images.*", "sparse/0/images.*")


@dataclass(frozen=True)
class Sources:
    """Either photographs, or recordings (one clip for each camera or place), and perhaps a sweep."""

    path: Path  # as given
    photographs: Clip | None = None
    clips: tuple[Clip, ...] = ()
    sweep: Clip | None = None

    def every(self) -> tuple[Clip, ...]:
        """All clips, the sweep last."""
        return tuple(clip for clip in (self.photographs, *self.clips, self.sweep) if clip is not None)


def find_sources(path: Path, timed: bool = False) -> Sources:
    """Return the contents of `path`. Raises CaptureError if it is missing, unusable, or mixes layouts.

    timed: a frame rate is given, so that a folder of pictures is a recording.
    """
    if not path.exists():
        raise CaptureError(f"{path}: does not exist")
    if path.is_file():
        if path.suffix.lower() not in RECORDING_SUFFIXES:
            raise CaptureError(f"{path}: is neither a folder nor a video ({NAMES})")
        return Sources(path, clips=(Clip(_named(path.stem), path),))
    if (part := whole_dataset(path)) is not None:
        raise CaptureError(f"{path}: is {part[1]}, whose poses are known: {train_command(part[0])}")
    if is_dataset(path):
        raise CaptureError(f"{path}: is a dataset already: {train_command(path)}")
    _check_read(path)
    pictures = _pictures(path)
    clips = [clip for clip in map(_clip, _entries(path)) if clip is not None]
    sweep = next((clip for clip in clips if clip.name == SWEEP), None)
    cameras = tuple(clip for clip in clips if clip is not sweep)
    if pictures:
        if clips:
            raise CaptureError(
                f"{path}: holds pictures and {clips[0].name} beside them; pictures of the scene at rest belong "
                f"into {SWEEP}/; {LAYOUTS}"
            )
        if len(pictures) < FEWEST:
            raise CaptureError(f"{path}: holds {len(pictures)} pictures, at least {FEWEST} are needed")
        clip = Clip(_named(path.name), path, pictures)
        return Sources(path, clips=(clip,)) if timed else Sources(path, photographs=clip)
    if not cameras:
        only = f"nothing but {SWEEP}" if sweep else "no pictures"
        raise CaptureError(f"{path}: holds {only}; {LAYOUTS}")
    names = [camera.name for camera in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise CaptureError(f"{path}: camera {twice} appears twice; rename one")
    return Sources(path, clips=cameras, sweep=sweep)


def is_dataset(path: Path) -> bool:
    """Return whether the folder is a dataset that `tg4mm train` reads."""
    return any(next(path.glob(pattern), None) is not None for pattern in DATASET)


def suggested_command(path: Path | str) -> str | None:
    """The `tg4mm sfm` command line for a video, or for a folder of photographs or videos; None for anything else."""
    path = Path(path)
    try:
        find_sources(path)
    except (CaptureError, OSError):
        return None
    out = path.with_name(f"{path.stem}_dataset")
    return f"tg4mm sfm {argument(path)} --out {argument(out)}"


def _check_read(path: Path) -> None:
    """Raises CaptureError for pictures that are not read, and for a sweep without any: both would go unnoticed."""
    sweep = path / SWEEP
    for folder in (path, *(p for p in _entries(path) if p.is_dir())):
        other = next((p for p in _entries(folder) if p.suffix.lower() in UNREAD), None)
        if other is not None:
            raise CaptureError(
                f"{other}: {other.suffix} is not read; convert it to .jpg, .png or .exr, or remove it"
            )
    if sweep.is_dir() and not _pictures(sweep):
        raise CaptureError(f"{sweep}: holds no pictures; expected {', '.join(IMAGE_SUFFIXES)}")


def _named(name: str) -> str:
    """The name of a clip that is given alone: called sweep it would be taken for the sweep of others."""
    return f"{name}_0" if name == SWEEP else name


def _entries(path: Path) -> list[Path]:
    return sorted((p for p in path.iterdir() if not p.name.startswith(".")), key=lambda p: natural(p.name))


def _pictures(path: Path) -> tuple[Path, ...]:
    return tuple(p for p in _entries(path) if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file())


def _clip(path: Path) -> Clip | None:
    if path.is_dir():
        pictures = _pictures(path)
        return Clip(path.name, path, pictures) if pictures else None
    return Clip(path.stem, path) if path.suffix.lower() in _IN_FOLDERS else None
