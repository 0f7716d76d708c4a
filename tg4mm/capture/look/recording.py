"""A recording as a look takes it: the frames of a video, or a folder of numbered pictures; duplicates left out."""

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from tg4mm.capture.codec import is_lossless
from tg4mm.capture.duplicates import DuplicateMeter
from tg4mm.capture.frames import IMAGE_SUFFIXES
from tg4mm.capture.look.reading import BETWEEN, FORWARD, INTRA, CellSeries, GreyPicture, read_cells
from tg4mm.capture.sfm.clip import (
    NAMES,
    WHOLE,
    TimeWindow,
    check_numbers,
    frame_rate,
    is_regular,
    regular_times,
)
from tg4mm.capture.transforms import natural
from tg4mm.capture.video import (
    RECORDING_SUFFIXES,
    VideoInfo,
    grey_frames,
    grey_of,
    is_untimed,
    video_info,
)
from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.decode import decode
from tg4mm.core.progress import Update, progress


def read_recording(
    path: Path,
    fps: float | None = None,
    window: TimeWindow = WHOLE,
    small_cells: bool = False,
    keep_duplicates: bool = False,
) -> tuple[CellSeries, tuple[int, ...]]:
    """Read the cells' series of a video or a folder of pictures, and the duplicate frames that were left out.

    fps: pictures a second; None: the video's own. window: of a video alone. small_cells: in large pictures, too.
    The times are those at which the other pictures were taken. keep_duplicates: none are looked for. Raises
    CaptureError where there is nothing to decode, or no rate is known.
    """
    if not path.exists():
        raise CaptureError(f"{path}: does not exist")
    if path.is_dir():
        return _folder(path, fps, small_cells), ()
    if path.suffix.lower() not in RECORDING_SUFFIXES:
        raise CaptureError(f"{path}: is neither a folder of pictures nor a video ({NAMES})")
    if fps is None and is_untimed(path):
        raise CaptureError(f"{path}: has no time stamps; give --fps, frames per second")
    info, meter = video_info(path), DuplicateMeter()
    fps = fps or info.filmed_at
    with progress("regions", _expected(info, window), "pictures", brief=True) as update:
        series = read_cells(
            _watched(video_pictures(path, fps, window), meter, update), str(path), small_cells
        )
    new, times, repeats = taken(path, series.times_s, fps, None if keep_duplicates else meter)
    return series.of_pictures(new, times), repeats


def taken(
    path: Path, stamps_s: np.ndarray, fps: float | None, meter: DuplicateMeter | None
) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Return the times of a video's pictures, and which repeat the one before.

    Args:
        path: the video.
        stamps_s: [F] times of all its pictures, seconds.
        fps: pictures a second, where the file's own times are not the recording's.
        meter: has seen all its pictures; None: no duplicates are looked for.

    Returns:
        Which pictures are new [F] bool, these ones' times in seconds, and the numbers of the others.
    """
    info, every = video_info(path), np.ones(len(stamps_s), bool)
    times = [Fraction(t).limit_denominator(10_000_000) for t in stamps_s.tolist()]
    rate = Fraction(fps).limit_denominator(1001) if fps else frame_rate(path, times, info.rates, info.tick)
    if meter is not None and (fps or is_regular(times, rate, info.tick)):
        found = meter.found()
        if found is not None:
            return found.is_new, np.array([float(t) for t in found.times(rate)]), found.rows
    if fps:
        return every, stamps_s, ()
    return every, np.array([float(t) for t in regular_times(times, rate, info.tick)]), ()


def _expected(info: VideoInfo, window: TimeWindow) -> int:
    if not info.duration_s:
        return max(info.total, 1)
    seconds = min(window.stop_s, info.duration_s) - window.start_s
    return max(1, round(info.total * seconds / info.duration_s))


def video_pictures(path: Path, fps: float | None = None, window: TimeWindow = WHOLE) -> Iterator[GreyPicture]:
    """A video's pictures with their own times, or those of a regular clock of `fps` pictures a second.

    In a lossless video prediction leaves no trace: every frame counts as coded alone.

    Raises CaptureError where it cannot be decoded.
    """
    lossless = is_lossless(path)
    for k, frame in enumerate(grey_frames(path, window.start_s, window.stop_s)):
        kind = INTRA if lossless or frame.is_alone else BETWEEN if frame.is_between else FORWARD
        yield GreyPicture(frame.grey, k / fps if fps else float(frame.time), kind)


def _watched(pictures: Iterator[GreyPicture], meter: DuplicateMeter, update: Update) -> Iterator[GreyPicture]:
    """Yield the pictures while updating the meter."""
    for k, picture in enumerate(pictures, 1):
        meter.add(picture.grey, picture.kind == INTRA, picture.kind == BETWEEN)
        yield picture
        update(k)


def _folder(path: Path, fps: float | None, small_cells: bool) -> CellSeries:
    files = sorted(
        (f for f in path.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES), key=lambda f: natural(f.name)
    )
    if not files:
        raise CaptureError(f"{path}: holds no pictures ({', '.join(IMAGE_SUFFIXES)})")
    if fps is None:
        raise CaptureError(
            f"{path}: a folder of pictures has no frame times; give the frame rate with --fps HZ"
        )
    check_numbers(files)

    def pictures() -> Iterator[GreyPicture]:
        with progress("regions", len(files), "pictures", brief=True) as update:
            for k, file in enumerate(files):
                yield GreyPicture(grey_of(decode(file)), k / fps)
                update(k + 1)

    return read_cells(pictures(), str(path), small_cells)
