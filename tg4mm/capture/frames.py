"""Pictures that are frames of a video in the dataset: `video/clip.mp4#37` is its frame 37, from 0, by time.

They are decoded when they are asked for, in the order of the file; asked for in order, each once. No
reader opens a file outside the dataset's folder.
"""

import math
import os
import re
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import islice
from pathlib import Path, PurePosixPath, PureWindowsPath
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from tg4mm.capture.planes import opaque, upright
from tg4mm.capture.video import VIDEO_SUFFIXES, av_module, opened, silent, stream_of
from tg4mm.core.errors import CaptureError
from tg4mm.core.pictures.decode import THREADS, ImageHeader, decode, image_header

T = TypeVar("T")
_FRAME = re.compile(
    rf"(.+(?:{'|'.join(map(re.escape, VIDEO_SUFFIXES))}))#([0-9]{{1,9}})", re.IGNORECASE | re.DOTALL
)
_OPEN = 32  # videos that stay open, and their indices

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".webp", ".tif", ".tiff")


@dataclass(frozen=True)
class Index:
    """The index of a video's frames by time."""

    stamps: tuple[int, ...]  # [T] rising, in units of `tick`
    keys: tuple[int, ...]  # frames that decoding can begin with
    tick: Fraction  # seconds

    @property
    def times(self) -> list[Fraction]:
        """Return [T] seconds since the first frame."""
        return [(stamp - self.stamps[0]) * self.tick for stamp in self.stamps]


def frame_of(path: Path) -> tuple[Path, int] | None:
    """The video and the frame's number; None for a picture of its own."""
    match = _FRAME.fullmatch(str(path))
    return (Path(match[1]), int(match[2])) if match else None


def index_of(video: Path) -> Index:
    """Read from the container alone, without decoding. Raises CaptureError if it is not a video."""
    state = video.stat()
    return _index(video, state.st_size, state.st_mtime_ns)


@lru_cache(_OPEN)
def _index(video: Path, size: int, changed_ns: int) -> Index:
    with opened(video) as container:
        stream = stream_of(container)
        try:
            packets = [
                (p.pts, p.is_keyframe, p.is_discard) for p in container.demux(stream) if p.pts is not None
            ]
        except av_module().FFmpegError as error:
            raise CaptureError(f"{video}: is damaged or cut off; copy it from the camera again") from error
        tick = Fraction(stream.time_base)
    first = next((stamp for stamp, is_key, _ in packets if is_key), -math.inf)  # none before is decoded
    stamps = tuple(sorted({stamp for stamp, _, is_left_out in packets if stamp >= first and not is_left_out}))
    if not stamps:
        raise CaptureError(f"{video}: holds no frames")
    number = {stamp: n for n, stamp in enumerate(stamps)}
    keys = {0} | {number[stamp] for stamp, is_key, _ in packets if is_key and stamp in number}
    return Index(stamps, tuple(sorted(keys)), tick)


def picture_header(path: Path) -> ImageHeader:
    """`image_header` of a picture, or of a frame without decoding it. CaptureError where the video ends before it."""
    frame = frame_of(path)
    if frame is None:
        return image_header(path)
    video, number = frame
    count = len(index_of(video).stamps)
    if number >= count:
        raise CaptureError(f"{path}: the video has {count} frames, 0 to {count - 1}")
    with _reader(video) as reader:
        return reader.header


def picture(path: Path) -> np.ndarray:
    """Return [H, W, 4] uint8 or uint16: `decode` of a picture, or a frame, upright."""
    frame = frame_of(path)
    if frame is None:
        return decode(path)
    with _reader(frame[0]) as reader:
        return reader.read(frame[1])


def each_picture(paths: Sequence[Path], use: Callable[[int, np.ndarray], None]) -> Iterator[int]:
    """Call `use` in threads with every number of `paths` and its picture; a video's frames are decoded in its order.

    Yields how many are done. On the first error, and on Ctrl-C, no further ones are begun.
    """
    frames = [(frame, k) for k, path in enumerate(paths) if (frame := frame_of(path)) is not None]
    others = [k for k in range(len(paths)) if frame_of(paths[k]) is None] if len(frames) < len(paths) else []
    done, futures = 0, deque[Future[None]]()
    with ThreadPoolExecutor(THREADS) as pool:
        try:
            for _, k in sorted(frames):
                futures.append(pool.submit(use, k, picture(paths[k])))
                if len(futures) > THREADS:
                    futures.popleft().result()
                    yield (done := done + 1)
            futures.extend(pool.submit(lambda k: use(k, decode(paths[k])), k) for k in others)
            while futures:
                futures.popleft().result()
                yield (done := done + 1)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def read_ahead(items: Iterable[T], most: int = THREADS) -> Iterator[T]:
    """Yield the items in their order, while one thread makes up to `most` of them in advance."""
    iterator = iter(items)
    with ThreadPoolExecutor(1) as pool:

        def following() -> Future[tuple[T, ...]]:
            return pool.submit(lambda: tuple(islice(iterator, 1)))

        ahead = deque(following() for _ in range(most))
        try:
            while one := ahead.popleft().result():
                ahead.append(following())
                yield one[0]
        finally:
            pool.shutdown(cancel_futures=True)


class _Reader:
    """One open video, and how far it has been decoded."""

    def __init__(self, video: Path) -> None:
        self.video, self.index, self.lock = video, index_of(video), Lock()
        self.number = {stamp: n for n, stamp in enumerate(self.index.stamps)}
        self.last = np.zeros((0, 0, 4), np.uint8)  # the frame that was decoded last,
        self.at: int = -1  # and its number
        self.container: Any
        self.stream: Any
        self._open()

    def __enter__(self) -> "_Reader":
        self.lock.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self.lock.release()

    @property
    def header(self) -> ImageHeader:
        pixels = self.last if self.last.size else self.read(0)
        return ImageHeader(pixels.shape[1], pixels.shape[0], 8 * pixels.itemsize)

    def read(self, number: int) -> np.ndarray:
        """Return [H, W, 4] uint8 or uint16."""
        if self.at == number:
            return self.last
        with silent():
            return self._read(number)

    def _read(self, number: int) -> np.ndarray:
        keys = self.index.keys
        key = keys[bisect_right(keys, number) - 1]
        try:
            if not 0 <= self.at < number or key > self.at:
                self.container.seek(self.index.stamps[key], stream=self.stream)
                self.frames = self.container.decode(self.stream)
            if not self._is_reached(number):  # a container whose index is wrong
                self._open()
                if not self._is_reached(number):
                    raise CaptureError(f"{self.video}: frame {number} cannot be decoded")
        except av_module().FFmpegError as error:
            self.at = -1
            raise CaptureError(f"{self.video}: frame {number} cannot be decoded: {error}") from error
        return self.last

    def _open(self) -> None:
        with silent():  # also while those of the container before it are closed
            self.container = self.stream = self.frames = None
        self.container = opened(self.video)
        self.stream = stream_of(self.container)
        self.stream.thread_type = "AUTO"
        self.frames, self.at = self.container.decode(self.stream), -1

    def _is_reached(self, number: int) -> bool:
        for frame in self.frames:
            self.at = self.number.get(frame.pts, -1)
            if self.at == number:
                self.last = upright(frame, opaque(frame))
            if self.at >= number:
                return self.at == number
        return False


def _reader(video: Path) -> _Reader:
    state = video.stat()
    return _kept_reader(video, state.st_size, state.st_mtime_ns, os.getpid())


@lru_cache(_OPEN)
def _kept_reader(video: Path, size: int, changed_ns: int, process: int) -> _Reader:
    return _Reader(video)


class MissingPictureError(CaptureError):
    """A picture that a dataset names is not there."""


def portable(folder: Path, name: str) -> str:
    """Return a file's name with the backslashes of Windows as slashes, unless there is a file that is called so."""
    return name.replace("\\", "/") if "\\" in name and not (folder / name).exists() else name


def inside(root: Path, path: Path, where: str) -> Path:
    """`path` unchanged if, links and .. resolved, it lies inside `root`; else CaptureError naming `where`."""
    try:
        leaves = not path.resolve().is_relative_to(root.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # a loop of links, a null byte
        raise CaptureError(f"{where}: {str(path)!r} is not a usable path: {error}") from error
    if leaves:
        raise CaptureError(f"{where}: {path} leads outside the dataset's folder {root}")
    return path


def image_path(root: Path, folder: Path, file_path: str, where: str) -> Path:
    """The image, or the frame of a video, that `file_path` means, relative to `folder`.

    Without a suffix those of `IMAGE_SUFFIXES` are tried. Raises CaptureError if it is absolute, leaves `root`, or is
    not there.
    """
    file_path = portable(folder, file_path)
    if PurePosixPath(file_path).is_absolute() or PureWindowsPath(file_path).drive:
        raise CaptureError(f"{where}: file_path {file_path!r} is absolute; expected one relative to {folder}")
    named = folder / file_path
    frame = frame_of(named)
    if frame is not None:
        if not inside(root, frame[0], where).is_file():
            raise CaptureError(f"{where}: video {frame[0]} does not exist")
        # one path for a video, whichever folder names it
        return root / os.path.normpath(named.relative_to(root))
    # Without with_suffix: "r_0.05" has no image suffix, and its ".05" must stay.
    has_suffix = named.suffix.lower() in IMAGE_SUFFIXES
    candidates = [named] if has_suffix else [named.with_name(named.name + s) for s in IMAGE_SUFFIXES]
    for candidate in candidates:
        if inside(root, candidate, where).is_file():
            return candidate
    if inside(root, named, where).is_file():
        kinds = ", ".join(IMAGE_SUFFIXES)
        raise CaptureError(f"{where}: image {named} has an unsupported type; expected one of {kinds}")
    tried = "" if has_suffix else f" (tried {', '.join(IMAGE_SUFFIXES)})"
    raise MissingPictureError(f"{where}: image {named} does not exist{tried}")
