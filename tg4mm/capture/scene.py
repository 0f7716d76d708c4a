"""scene.json: what a dataset says about itself (docs/conventions.md lists its keys)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.frames import inside
from tg4mm.capture.model import CLOCKS
from tg4mm.core.choices import KINDS, Kind
from tg4mm.core.errors import CaptureError
from tg4mm.core.untrusted import JsonRecord, read_record
from tg4mm.core.values import Maybe, Number, check_form

FORMAT_VERSION = 1
KINDS_OF_PICTURES = "IPB"  # coded by themselves, predicted forward, predicted from both sides
LONGEST_CODEC_PERIOD = 8  # frames; of a longer one, as between key frames, every frequency is near a multiple
_FASTEST = 1e9  # Hz
_SLOWEST_READOUT_S = 1.0  # where no rate is known
# Keys that nothing here needs but others read: their type is checked, null counts as absent.
_COUNTS = ("width", "height", "n_train", "n_test", "codec_period")
_FORM = {
    **dict.fromkeys(("frequency_hz?", "amplitude?", "pixels_per_unit?"), Maybe(float)),
    **dict.fromkeys(("scene?", "background?", "picture_kinds?"), Maybe(str)),
    **dict.fromkeys(("sfm?", "video?", "engine?"), Maybe(dict)),
    "modes?": Maybe([dict]),
    "alphas?": Maybe([float]),
}


@dataclass(frozen=True)
class SceneDescription:
    """The part of scene.json that readers use, and all of it as read."""

    fps: float = 0.0  # Hz; 0.0 if unknown
    n_timesteps: int | None = None
    unit_scale_m: float | None = None  # metres per scene unit
    kind: Kind | None = None  # None: it does not say
    clocks: str = ""  # one of CLOCKS; "" if it does not say
    readout_s: float = 0.0  # from a picture's first row to its last; 0: all rows at once
    values: dict[str, Any] = field(default_factory=dict)


def codec_period(root: Path) -> int | None:
    """Frames, as `tg4mm sfm` found it in the video; None for pictures, and where a video has no such period."""
    period = read_scene(root, needs_fps=False).values.get("codec_period")
    return int(period) if period and 2 <= period <= LONGEST_CODEC_PERIOD else None


def picture_kinds(root: Path, count: int) -> list[int] | None:
    """Return the coding of each of the video's pictures, as FFmpeg numbers I, P and B, or None if unknown."""
    recorded = read_scene(root, needs_fps=False).values.get("picture_kinds") or ""
    if len(recorded) != count or recorded.strip(KINDS_OF_PICTURES):
        return None
    return [KINDS_OF_PICTURES.index(kind) + 1 for kind in recorded]


def is_coded(root: Path) -> bool:
    """Return whether the pictures are known to come from a video."""
    values = read_scene(root, needs_fps=False).values
    return bool(values.get("video") or values.get("codec_period") or values.get("picture_kinds"))


def between_frames(root: Path, n_timesteps: int) -> np.ndarray | None:
    """Return [T] bool: the B-frames of the one video; None if that is not known."""
    kinds = picture_kinds(root, n_timesteps)
    return None if kinds is None or 3 not in kinds else np.array(kinds) == 3


@dataclass(frozen=True)
class VideoFile:
    """The video that a dataset's pictures are of."""

    path: Path
    from_s: float  # of it that comes before the pictures
    repeats: tuple[int, ...]  # frames from there on that show the picture before them again, and are left out


def video_file(root: Path) -> VideoFile | None:
    """Return the video linked by `tg4mm sfm`, None for pictures. Raises CaptureError if scene.json is damaged."""
    where = root / "scene.json"
    entry = read_scene(root, needs_fps=False).values.get("video")
    if entry is None:
        return None
    record = JsonRecord(f"{where}: video", entry)
    repeats = entry.get("repeats", [])
    if not isinstance(entry.get("file"), str):
        raise record.error("file", "the name of a video")
    if not isinstance(repeats, list) or not all(isinstance(k, int) and k >= 0 for k in repeats):
        raise record.error("repeats", "a list of frames")
    path = inside(root, root / entry["file"], str(where))
    return VideoFile(path, record.number("from_s", low=-1.0), tuple(repeats)) if path.is_file() else None


def read_scene(root: Path, needs_fps: bool) -> SceneDescription:
    """Read root/scene.json, empty if absent; CaptureError for a wrong type, or for no fps if needed."""
    path = inside(root, root / "scene.json", "scene.json")
    if not path.is_file():
        if needs_fps:
            raise CaptureError(f'{path}: does not exist; expected at least {{"fps": <frames per second>}}')
        return SceneDescription()
    record = read_record(path)
    _check_types(record)
    fps = record.number("fps", low=0.0, high=_FASTEST) if needs_fps or record.has("fps") else 0.0
    return SceneDescription(
        fps=fps,
        n_timesteps=record.whole("n_timesteps", 1) if record.has("n_timesteps") else None,
        unit_scale_m=record.number("unit_scale_m", low=0.0) if record.has("unit_scale_m") else None,
        kind=Kind(kind) if (kind := _one_of(record, "kind", KINDS)) else None,
        clocks=_one_of(record, "clocks", CLOCKS),
        readout_s=_readout(record, fps),
        values=record.values,
    )


def _readout(record: JsonRecord, fps: float) -> float:
    if not record.has("readout_s"):
        return 0.0
    rule = Number(0, 1 / fps if fps else _SLOWEST_READOUT_S)
    if not rule.fits(record.values["readout_s"]):
        raise record.error(
            "readout_s", f"{rule}: seconds from a picture's first row to its last, at most one frame"
        )
    return float(record.values["readout_s"])


def _one_of(record: JsonRecord, key: str, values: Sequence[str]) -> str:
    if not record.has(key):
        return ""
    if record.values[key] not in values:
        raise record.error(key, f"one of {', '.join(values)}")
    return record.values[key]


def _check_types(record: JsonRecord) -> None:
    if record.has("format_version") and record.whole("format_version", 0) != FORMAT_VERSION:
        raise record.error("format_version", f"{FORMAT_VERSION}, the version this reader knows")
    for key in _COUNTS:
        if record.has(key):
            record.whole(key, 0)
    try:
        check_form(record.values, _FORM)
    except ValueError as error:
        raise CaptureError(f"{record.where}: {error}") from None
