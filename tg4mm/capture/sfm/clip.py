"""A camera's pictures in order: the frames of a video or the files of a folder, each with its time.

`find_sources` finds what lies on disk: photographs, one or several recordings, perhaps a sweep.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.capture.frames import IMAGE_SUFFIXES
from tg4mm.capture.stacks import PHOTRON_SUFFIXES, is_stack
from tg4mm.capture.transforms import natural, train_command, whole_dataset
from tg4mm.capture.video import RECORDING_SUFFIXES, VIDEO_SUFFIXES, is_untimed, video_frames
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import argument, write_atomic
from tg4mm.core.pictures import png
from tg4mm.core.pictures.decode import decode
from tg4mm.core.progress import progress

NAMES = ", ".join(RECORDING_SUFFIXES)
_FINE = 100_000  # parts of a picture a second
_ROUNDING = 1e-6  # of a tick, and seconds where there is none: of times as floats
UNEVEN = 0.2  # of the median step, that a step must differ by for a frame rate to count as variable

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
# Files that distinguish a dataset for `tg4mm train` from a folder of pictures.
DATASET = ("scene.json", "transforms*.json", "*/transforms_*.json", "sparse/images.*", "sparse/0/images.*")
KEYS = 80  # sharp frames that poses are first found from, at most
SWEEP_FRAMES = 60  # of a video of the scene at rest


@dataclass(frozen=True)
class TimeWindow:
    """The time window used of every recording, seconds since its first frame."""

    start_s: float = 0.0
    stop_s: float = math.inf

    @property
    def is_all(self) -> bool:
        """Return whether the window covers everything."""
        return self.start_s <= 0 and math.isinf(self.stop_s)


WHOLE = TimeWindow()


@dataclass(frozen=True)
class Clip:
    """Pictures in order: those of a folder, or the frames of a video."""

    name: str
    path: Path  # folder or video
    pictures: tuple[Path, ...] = ()  # of a folder
    repeats: frozenset[int] = frozenset()  # frames of a video's window that are left out
    window: TimeWindow | None = None  # which part of a video the clip is, where another clip is of it, too

    def without(self, rows: Iterable[int]) -> "Clip":
        """The clip less some of its pictures, by their rows."""
        out = frozenset(rows)
        if self.pictures:
            return replace(self, pictures=tuple(p for i, p in enumerate(self.pictures) if i not in out))
        return replace(self, repeats=out)

    @property
    def is_video(self) -> bool:
        """Return whether the pictures are frames of one file."""
        return self.path.suffix.lower() in RECORDING_SUFFIXES and self.path.is_file()

    @property
    def is_coded(self) -> bool:
        """Return whether that file is a video that can be decoded frame by frame."""
        return self.is_video and not is_stack(self.path)

    @property
    def is_untimed(self) -> bool:
        """Return whether the times of the pictures follow from their rate alone."""
        return not self.is_video or is_untimed(self.path)


@dataclass(frozen=True)
class Frame:
    """One picture of a clip."""

    index: int  # among those taken
    time: Fraction | None  # seconds as the container has them; a folder's pictures have none
    pixels: np.ndarray  # [H, W, 3] uint8, or [H, W, 4] uint8 or uint16
    path: Path | None  # the file it is
    is_between: bool = False  # of a video: predicted from the frames on both sides
    is_alone: bool = True  # coded without regard to other frames


def clip_frames(clip: Clip, window: TimeWindow = WHOLE) -> Iterator[Frame]:
    """The clip's pictures one by one. Raises CaptureError where one cannot be decoded."""
    if clip.is_video:
        every = enumerate(video_frames(clip.path, window.start_s, window.stop_s))
        kept = (frame for row, frame in every if row not in clip.repeats)
        for i, frame in enumerate(kept):
            time = None if clip.is_untimed else frame.time
            yield Frame(i, time, frame.pixels, None, frame.is_between, frame.is_alone)
    else:
        for i, path in enumerate(clip.pictures):
            yield Frame(i, None, decode(path), path)


def frame_rate(
    path: Path, times: list[Fraction], rates: tuple[Fraction, ...], tick: Fraction = Fraction(0)
) -> Fraction:
    """Frames per second of time stamps [T], which are whole numbers of `tick` seconds.

    Where they are those of a regular clock: one of a whole number of frames per second, or of NTSC's 1000/1001 of it,
    that of the container first; else what fits them best, as a camera's own clock may differ. Where they are of no
    regular clock, of the container's rates the one nearest to their usual step; one over that where none is near.
    Raises CaptureError where the stamps do not rise, so that there is no rate.
    """
    if is_untimed(path):
        raise CaptureError(f"{path}: has no time stamps; give --fps, frames per second")
    steps = sorted(b - a for a, b in pairwise(times))
    if not steps or steps[0] <= 0:
        raise CaptureError(
            f"{path}: its time stamps do not increase, so the frame rate is unknown; give --fps"
        )
    for numbers in (np.arange(len(times)), _numbers(times)):
        fitted = Fraction(_slope(times, numbers)).limit_denominator(_FINE)
        usual = [Fraction(round(fitted)), Fraction(round(fitted * 1001 / 1000) * 1000, 1001)]
        usual.sort(key=lambda rate: float(np.ptp(_misfits(times, rate or fitted, numbers))))
        common = [rate for rate in (*rates, *usual) if rate in usual]
        once = [(rate, 1 + hair) for hair in (-_ROUNDING, _ROUNDING) for rate in common]
        for rate, ticks in (*once, (fitted, 2)):
            if rate > 0 and _fit(times, rate, tick, numbers, ticks):
                return rate
    median = steps[len(steps) // 2]
    near = [step for step in steps if abs(step - median) <= median / 2]
    mean = sum(near, start=Fraction(0)) / len(near)
    nearest = min(rates, key=lambda rate: abs(rate * mean - 1), default=None)
    if nearest is not None and abs(nearest * mean - 1) <= Fraction(1, 100):
        return nearest
    return (1 / mean).limit_denominator(1001)


def is_regular(times: list[Fraction], fps: Fraction, tick: Fraction) -> bool:
    """Return whether time stamps [T] are those of a regular clock rounded to multiples of `tick` seconds."""
    return _fit(times, fps, tick, np.arange(len(times)))


def regular_times(times: list[Fraction], fps: Fraction, tick: Fraction) -> list[Fraction]:
    """The times of a regular clock where the stamps differ from it by rounding only, else the stamps themselves.

    Some containers keep whole milliseconds, or 600ths of a second: k / fps is then nearer to the truth than what is
    written. Frames may be missing.
    """
    for numbers in (np.arange(len(times)), _numbers(times)):
        if _fit(times, fps, tick, numbers):
            return [times[0] + int(k) / fps for k in numbers]
    return times


def _fit(times: list[Fraction], fps: Fraction, tick: Fraction, numbers: np.ndarray, ticks: float = 2) -> bool:
    """Return whether stamps [T] are those of frames `numbers` [T], rounded to ticks, or to longer ones written in them.

    ticks: over which what was rounded once (1), or more than once, spreads.
    """
    if tick:
        written = math.gcd(*(round((time - times[0]) / tick) for time in times)) * tick
        tick = written if written * fps <= Fraction(1, 2) else tick
    return bool(np.ptp(_misfits(times, fps, numbers)) <= max(ticks * float(tick), _ROUNDING))


def _numbers(times: list[Fraction]) -> np.ndarray:
    """Return [T] frames' numbers from 0, where some are missing."""
    steps = np.diff([float(time) for time in times])
    median = np.sort(steps)[len(steps) // 2]
    near = steps[np.abs(steps - median) <= median / 2]
    return np.concatenate([[0], np.cumsum(np.maximum(np.round(steps / near.mean()), 1))])


def _misfits(times: list[Fraction], fps: Fraction, numbers: np.ndarray) -> np.ndarray:
    """Return [T] seconds by which stamps are later than a regular clock that begins with the first."""
    return np.array([float(time - times[0]) for time in times]) - numbers / float(fps)


def _slope(times: list[Fraction], numbers: np.ndarray) -> float:
    """Stamps per second, by least squares."""
    k = numbers - numbers.mean()
    return float((k @ k) / (k @ np.array([float(time - times[0]) for time in times])))


def uneven_steps(times_s: np.ndarray) -> tuple[float, float] | None:
    """The smallest and largest step in seconds where the frame rate varies, else None."""
    steps = np.diff(times_s)
    if not len(steps):
        return None
    median = float(np.median(steps))
    uneven = np.abs(steps - median).max() > UNEVEN * median
    return (float(steps.min()), float(steps.max())) if uneven else None


def check_numbers(pictures: Sequence[Path]) -> None:
    """Raise CaptureError where the numbers at the end of pictures' names, in order, leave some out."""
    ends = [re.search(r"\d+$", path.stem) for path in pictures]
    numbers = [int(end[0]) for end in ends if end is not None]
    if len(numbers) < len(pictures) or len(pictures) < 3:
        return
    steps = [b - a for a, b in pairwise(numbers)]
    step = min(steps)
    odd = [k for k, one in enumerate(steps) if one != step]
    if step > 0 and 0 < len(odd) < len(steps) / 2 and all(one % step == 0 for one in steps):
        k = odd[0]
        raise CaptureError(
            f"{pictures[k]}: pictures between it and {pictures[k + 1].name} are missing, so later times would be "
            "wrong; give a part without gaps"
        )


def save_png(path: Path, pixels: np.ndarray, level: int = 1) -> None:
    """Write pixels [H, W, 3 or 4] as a PNG of 8 or 16 bits, whole or not at all. level: of compression, 0 to 9."""
    if pixels.dtype == np.uint16:
        data = png.encode(png.fewest_channels(pixels), level, filtered=False)
        write_atomic(path, lambda temporary: temporary.write_bytes(data))
        return
    image = Image.fromarray(pixels)
    write_atomic(path, lambda temporary: image.save(temporary, format="PNG", compress_level=level))


def sharp_rows(sharpness: np.ndarray, most: int) -> np.ndarray:
    """Indices of the sharpest frame in each of equally long windows; at most `most`, and no more than every second."""
    n = len(sharpness)
    windows = np.array_split(np.arange(n), max(1, min(most, -(-n // 2))))
    return np.array([window[int(np.argmax(sharpness[window]))] for window in windows])


def extract_frames(
    clip: Clip, folder: Path, window: TimeWindow = WHOLE, rows: Iterable[int] | None = None, total: int = 0
) -> tuple[Path, ...]:
    """folder/00000.png …, the frames `rows` of a clip (None: all of its `total`); those there are kept.

    A folder's pictures stay where they are.
    """
    wanted = range(total) if rows is None else sorted(int(row) for row in rows)
    if clip.pictures:
        return tuple(clip.pictures[row] for row in wanted)
    paths = {row: folder / f"{row:05d}.png" for row in wanted}
    missing = {row: path for row, path in paths.items() if not path.is_file()}
    if missing:
        folder.mkdir(parents=True, exist_ok=True)
        with progress(f"frames of {clip.name}", len(missing), "frames") as update:
            done = 0
            for frame in clip_frames(clip, window):
                if frame.index in missing:
                    save_png(missing[frame.index], frame.pixels)
                    done += 1
                    update(done)
                if done == len(missing):
                    break
    return tuple(paths[row] for row in wanted)


@dataclass(frozen=True)
class Sources:
    """Input: either photographs, or recordings (one clip for each camera or place), and perhaps a sweep."""

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
                f"in {SWEEP}/; {LAYOUTS}"
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
    """Raise CaptureError for pictures that would not be read, and for a sweep without any."""
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
