"""Recordings in one file: what it says of itself, and the frames one by one with their exact times; videos by PyAV."""

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tg4mm.capture.planes import (
    AS_STORED,
    LUMA,
    colours,
    luma,
    orientation_of,
    say_once,
    say_what_it_is,
    upright,
)
from tg4mm.capture.stacks import STACK_SUFFIXES, TIFF_SUFFIXES, is_stack, stack_info, stack_pictures
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.extras import install

# What FFmpeg's decoders write to their log when they cover up damage and hand out a frame all the same.
DAMAGE = ("error while decoding", "invalid nal unit size", "partial file", "corrupt")
_CUTS = "its edit list cuts it, or slows a part down: all pictures are taken, at the times that the camera gave them"
_FASTEST = 1e6  # pictures a second
HAIR_S = 1e-6  # seconds by which a decimal may miss the fraction it means
ALONE, FORWARD, BETWEEN = 1, 2, 3  # FFmpeg's AV_PICTURE_TYPE_I, _P and _B
BARE_SUFFIXES = (".h264", ".264", ".h265", ".265", ".hevc")  # streams without a container
VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".3gp", ".gif", ".ts", ".mts", ".m2ts", ".cine"),
    *BARE_SUFFIXES,
)
RECORDING_SUFFIXES = (*VIDEO_SUFFIXES, *STACK_SUFFIXES)
# FFmpeg's names of their formats: what a file holds is never a list of other files, or of addresses.
_FORMATS = "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,gif,mpegts,mpeg,cine,h264,hevc"
_SQUARE = 0.005  # by which a pixel's sides may differ
_NOMINAL = 25  # pictures a second of what does not say
_IS_DEFAULT, _IS_COVER = 1, 1 << 10  # FFmpeg's AV_DISPOSITION_DEFAULT and _ATTACHED_PIC
_WORTH = 5_000_000  # pixels that being the default is worth to ffmpeg where it chooses a stream
_SLOWED = 1.5  # times the file's own rate, or its inverse, from which a capture rate counts,
_HIGH_SPEED = 100  # and pictures a second: no camera takes that many by day and a part of them in the dark
_LOST_S = 0.05  # of a video's beginning or end: more is reported

_SUFFIXES = (".mp4", ".mov", ".m4v", ".3gp")
_NORMAL = 1 << 16  # the speed of an edit, in 16.16 bits
_MOST = 1000  # boxes, and entries of a list, that are looked at


@dataclass(frozen=True)
class VideoInfo:
    """A container's description of its video; none of it is certain until all frames are decoded."""

    rates: tuple[Fraction, ...]  # frames per second: average, then nominal; empty if it does not say
    tick: Fraction  # seconds, in whole numbers of which time stamps are written
    duration_s: float | None
    total: int  # frames, an estimate; 0 if unknown
    created: datetime | None  # when the recording began, where the camera wrote it down
    filmed_at: float | None = None  # frames per second, where the file says that its times are others


@dataclass(frozen=True)
class CodedFrame:
    """One decoded frame."""

    time: Fraction  # seconds since the video's first frame, as the container has it
    is_between: bool  # a B picture: predicted from both sides
    is_alone: bool  # an I picture: not predicted


@dataclass(frozen=True)
class VideoFrame(CodedFrame):
    """One decoded frame in colour, upright."""

    pixels: np.ndarray  # [H, W, 3] uint8, or [H, W, 4] uint8 or uint16 of what holds more


@dataclass(frozen=True)
class GreyFrame(CodedFrame):
    """One decoded frame's luma as it is coded, upright."""

    grey: np.ndarray  # [H, W] uint8, or float32 of that range of what holds more


def av_module() -> Any:
    """PyAV. Raises Tg4mmError where it is absent."""
    try:
        import av
        import av.logging
    except ImportError as error:
        raise Tg4mmError(f"reading videos needs PyAV ({error}): {install('core')}") from None
    av.logging.set_level(av.logging.ERROR)  # so that damage which FFmpeg covers up can be seen
    return av


@contextmanager
def silent() -> Iterator[None]:
    """Keep FFmpeg from logging: its threads need Python's lock for that, and would block who holds it and ends them."""
    av_module().logging.set_level(None)
    try:
        yield
    finally:
        av_module()


def video_info(path: Path) -> VideoInfo:
    """The file's own figures. Raises CaptureError where it is no video that can be decoded."""
    if is_stack(path):
        stack = stack_info(path)
        if stack.rate is None:
            return VideoInfo((), Fraction(0), None, stack.count, None)
        return VideoInfo((stack.rate,), Fraction(0), stack.count / float(stack.rate), stack.count, None)
    with opened(path) as container:
        stream = stream_of(container)
        rates = [stream.average_rate, stream.base_rate, stream.guessed_rate]
        known = tuple(dict.fromkeys(Fraction(rate) for rate in rates if rate))
        duration = _duration(container, stream)
        total = stream.frames or round((duration or 0) * float(known[0] if known else 0))
        created, filmed_at = _created(container, stream), _filmed_at(path, container, known)
        return VideoInfo(known, Fraction(stream.time_base), duration, total, created, filmed_at)


def video_frames(path: Path, start_s: float = 0.0, stop_s: float = math.inf) -> Iterator[VideoFrame]:
    """Frames from start_s up to stop_s (seconds since the first), in order, turned upright as the container asks.

    Raises CaptureError, naming the second, where decoding fails, damage is covered up, or the file ends early.
    """
    if is_stack(path):
        for time, pixels in _stacked(path, start_s, stop_s):
            yield VideoFrame(time, False, True, pixels)
        return
    for coded, frame in _decoded(path, start_s, stop_s):
        yield VideoFrame(coded.time, coded.is_between, coded.is_alone, upright(frame, colours(frame)))


def grey_frames(path: Path, start_s: float = 0.0, stop_s: float = math.inf) -> Iterator[GreyFrame]:
    """Yield frames like `video_frames`, but luma alone."""
    if is_stack(path):
        for time, pixels in _stacked(path, start_s, stop_s):
            yield GreyFrame(time, False, True, grey_of(pixels))
        return
    for coded, frame in _decoded(path, start_s, stop_s):
        yield GreyFrame(coded.time, coded.is_between, coded.is_alone, upright(frame, luma(frame)))


def is_untimed(path: Path) -> bool:
    """Return whether the file has neither times nor a rate, judged by its name."""
    return path.suffix.lower() in (*BARE_SUFFIXES, *TIFF_SUFFIXES)


def grey_of(rgba: np.ndarray) -> np.ndarray:
    """Return [H, W] float32, 0 to 255: luma of pixels [H, W, 3 or 4] uint8 or uint16."""
    scale = 255 / np.iinfo(rgba.dtype).max
    return np.asarray((rgba[..., :3].astype(np.float32) @ LUMA) * np.float32(scale))


def _stacked(path: Path, start_s: float, stop_s: float) -> Iterator[tuple[Fraction, np.ndarray]]:
    """Times, seconds since the first, and pixels [H, W, 4] of a stack."""
    _check_window(path, start_s, stop_s)
    rate = stack_info(path).rate or Fraction(_NOMINAL)
    for k, pixels in enumerate(stack_pictures(path)):
        if k / rate >= stop_s - HAIR_S:
            return
        if k / rate >= start_s - HAIR_S:
            yield k / rate, pixels


def _check_window(path: Path, start_s: float, stop_s: float) -> None:
    if is_untimed(path) and (start_s > 0 or math.isfinite(stop_s)):
        raise CaptureError(f"{path}: has no time stamps, so --from and --until cannot be used")


def _decoded(path: Path, start_s: float, stop_s: float) -> Iterator[tuple[CodedFrame, Any]]:
    """Frames with PyAV's own, as they lie in the file."""
    av, untimed = av_module(), is_untimed(path)
    _check_window(path, start_s, stop_s)
    first: Fraction | None = None
    count = 0
    size: tuple[int, int] | None = None
    time, step, lost_s = Fraction(0), Fraction(0), 0.0
    with _settled(path), av.logging.Capture(False) as log, opened(path) as container:
        stream = stream_of(container)
        stream.codec_context.thread_type = "NONE"  # its log then belongs to the frame that comes next
        log.clear()
        frames = _frames(container, stream)
        while True:
            try:
                is_corrupt, frame = next(frames, (False, None))
            except av.FFmpegError as error:
                raise _damaged(path, time, _duration(container, stream)) from error
            is_corrupt = is_corrupt or any(word in text.lower() for _, _, text in log for word in DAMAGE)
            if first is not None and is_corrupt:
                raise _damaged(path, time, _duration(container, stream))
            log.clear()
            if frame is None:
                break
            say_what_it_is(path, frame)
            if frame.pts is None and not untimed:
                raise CaptureError(
                    f"{path}: its frames have no time stamps; put it into an MP4 or MKV container"
                )
            stamp = Fraction(count, _NOMINAL) if untimed else frame.pts * Fraction(frame.time_base)
            count += 1
            if first is None:
                first, lost_s = stamp, 0.0 if untimed else _lost_s(path, stream, stamp)
            before, time = time, stamp - first
            step = max(step, time - before)
            if time >= stop_s - HAIR_S:
                return
            if time >= start_s - HAIR_S:
                size = size or (frame.width, frame.height)
                if size != (frame.width, frame.height):
                    raise _resized(path, size, frame, None if untimed or time < before else time, count - 1)
                kind = int(frame.pict_type)
                yield CodedFrame(time, kind == BETWEEN, kind == ALONE), frame
        duration = None if untimed else _duration(container, stream)
    if first is None:
        raise CaptureError(f"{path}: holds no frames")
    if duration is not None and lost_s + float(time + 2 * step) < duration - _LOST_S:
        raise _damaged(path, time, duration)


def _frames(container: Any, stream: Any) -> Iterator[tuple[bool, Any]]:
    """Frames, and whether a packet of which parts are missing was among those that made them."""
    for packet in container.demux(stream):
        frames = packet.decode()
        yield from ((packet.is_corrupt, frame) for frame in frames)


@contextmanager
def _settled(path: Path) -> Iterator[None]:
    """Raises CaptureError, whatever else is wrong, where the file's size changes meanwhile."""
    size = path.stat().st_size
    try:
        yield
    finally:
        if (now := path.stat().st_size) != size:
            raise CaptureError(
                f"{path}: changed while it was read, from {size:,} to {now:,} bytes: it is still being recorded or "
                "copied; run the command again when it is complete"
            )


def is_turned(path: Path) -> bool:
    """Return whether the container prescribes to turn or mirror pictures when they are shown."""
    if is_stack(path):
        return False
    with opened(path) as container:
        frame = next(container.decode(stream_of(container)), None)
    return frame is not None and orientation_of(frame) != AS_STORED


def file_url(path: Path) -> str:
    """Return the file as a URL, because FFmpeg reads names such as `12:30:00.mp4` and `http:o` as addresses."""
    return f"file:{path}"


def opened(path: Path) -> Any:
    """The container, open, with a video in it whose decoder is known."""
    av = av_module()
    try:
        with av.logging.Capture(False):
            options = {"format_whitelist": _FORMATS, "protocol_whitelist": "file"}
            if has_cuts(path):
                options["ignore_editlist"] = "1"
                say_once(path, _CUTS)
            container = av.open(file_url(path), container_options=options)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise CaptureError(
            f"{path}: is not a video that can be decoded, or its index, at the end of the file, is missing; copy it "
            "from the camera again"
        ) from error
    # A stream without codec context takes the whole process down when it is decoded.
    if stream_of(container) is None:
        container.close()
        raise CaptureError(f"{path}: holds no video that can be decoded")
    shape = stream_of(container).sample_aspect_ratio
    if shape and abs(shape - 1) > _SQUARE:
        container.close()
        raise CaptureError(
            f"{path}: is anamorphic: its pixels are {shape.numerator}:{shape.denominator}, not square; "
            "convert it with ffmpeg -vf scale=iw*sar:ih,setsar=1"
        )
    return container


def stream_of(container: Any) -> Any:
    """The video stream that ffmpeg takes: the default one, else the largest; None where none can be decoded."""

    def score(stream: Any) -> int:
        disposition = stream.disposition.value
        if disposition & _IS_COVER:
            return 1
        return int(stream.width * stream.height) + _WORTH * bool(disposition & _IS_DEFAULT)

    streams = [stream for stream in container.streams.video if stream.codec_context is not None]
    return max(streams, key=score, default=None)


def _filmed_at(path: Path, container: Any, rates: Sequence[Fraction]) -> float | None:
    """Return the rate, Hz, at which Android's camera filmed slow motion that it stored slowed down; None if unknown."""
    try:
        rate = float(container.metadata.get("com.android.capture.fps", "nan"))
    except ValueError:
        return None
    if not (rates and 0 < rate < _FASTEST) or 1 / _SLOWED < rate / rates[0] < _SLOWED:
        return None
    if rates[0] < rate < _HIGH_SPEED:  # or the camera took fewer in the dark
        say_once(
            path,
            f"says that {rate:g} pictures a second were filmed, its times say {float(rates[0]):.5g}, which are taken; "
            f"of slow motion give --fps {rate:g}",
        )
        return None
    say_once(
        path,
        f"says that {rate:g} pictures a second were filmed, which is taken; its times, of {float(rates[0]):.5g} a "
        f"second, are those of {'slow motion' if rate > rates[0] else 'time lapse'} (--fps gives another rate)",
    )
    return rate


def _lost_s(path: Path, stream: Any, first: Fraction) -> float:
    """Return the seconds before the first picture that can be decoded, with a warning."""
    start = first if stream.start_time is None else stream.start_time * stream.time_base
    lost = max(float(first - start), 0.0)
    if lost > _LOST_S:
        say_once(
            path, f"its first {lost:.2f} s cannot be decoded, as it was cut there; times are from what can be"
        )
    return lost


def _resized(
    path: Path, size: tuple[int, int], frame: Any, time: Fraction | None, count: int
) -> CaptureError:
    """Return the error. time: None if no time separates the parts; count: of the frames before."""
    change = f"{path}: its pictures change from {size[0]}×{size[1]} to {frame.width}×{frame.height} pixels"
    if time is None:
        return CaptureError(
            f"{change} after {count}; take these with ffmpeg -i {path} -frames:v {count} PART"
        )
    last = math.floor(time * 100) / 100
    return CaptureError(f"{change} at {last:.2f} s; use the part before with --until {last:.2f}")


def _duration(container: Any, stream: Any) -> float | None:
    """Seconds of the video stream; the container's length is that of its longest stream."""
    if stream.duration:
        # what an edit list adds
        late = max(stream.start_time or 0, 0) if "mov" in container.format.name else 0
        return float((stream.duration - late) * stream.time_base)
    if container.duration and len(container.streams) == 1:
        return container.duration / 1e6
    return None


def _created(container: Any, stream: Any) -> datetime | None:
    text = stream.metadata.get("creation_time") or container.metadata.get("creation_time")
    try:
        return datetime.fromisoformat(text.replace("Z", "+00:00")) if text else None
    except ValueError:
        return None


def _damaged(path: Path, time: Fraction, duration: float | None) -> CaptureError:
    whole = "" if duration is None else f" of {duration:.2f} s"
    last = math.floor(time * 100) / 100  # rounded up, --until would ask for what cannot be decoded
    return CaptureError(
        f"{path}: is damaged or cut off: decoding stops at {last:.2f} s{whole}; "
        f"use the part before it with --until {last:.2f}, or record it again"
    )


def has_cuts(path: Path) -> bool:
    """Return whether a video's edit list shows several stretches of it, or one at another speed than the recorded one.

    FFmpeg ignores speeds, and shows frames between two stretches of slow motion twice.
    """
    if path.suffix.lower() not in _SUFFIXES:
        return False
    with path.open("rb") as file:
        whole = 0, file.seek(0, 2)
        videos = (t for t in _inside(file, whole, b"moov", b"trak") if _is_video(file, t))
        return any(_cuts(file, *edits) for t in videos for edits in _inside(file, t, b"edts", b"elst"))


def _inside(file: BinaryIO, span: tuple[int, int], *kinds: bytes) -> list[tuple[int, int]]:
    """Start and end of the contents of all boxes of the last kind, in those of the kinds before it."""
    spans = [span]
    for kind in kinds:
        spans = [(a, b) for span in spans for found, a, b in _boxes(file, *span) if found == kind]
    return spans


def _is_video(file: BinaryIO, track: tuple[int, int]) -> bool:
    for start, _ in _inside(file, track, b"mdia", b"hdlr"):
        file.seek(start + 8)
        return file.read(4) == b"vide"
    return False


def _boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, start and end of the contents of the boxes that lie in a stretch of the file."""
    for _ in range(_MOST):
        file.seek(start)
        head = file.read(16)
        if end - start < 8 or len(head) < 8:
            return
        size, kind = struct.unpack_from(">I4s", head)
        inner = start + 8
        if size == 1 and len(head) == 16:
            size, inner = struct.unpack_from(">Q", head, 8)[0], start + 16
        stop = end if size == 0 else start + size
        if not inner <= stop <= end:
            return
        yield kind, inner, stop
        start = stop


def _cuts(file: BinaryIO, start: int, end: int) -> bool:
    """Return whether an edit list does more than set the track's beginning."""
    file.seek(start)
    data = file.read(min(end - start, 8 + 20 * _MOST))
    if len(data) < 8:
        return False
    version, count = data[0], struct.unpack_from(">I", data, 4)[0]
    layout = struct.Struct(">Qqi" if version == 1 else ">Iii")
    count = min(count, (len(data) - 8) // layout.size)
    edits = [layout.unpack_from(data, 8 + k * layout.size) for k in range(count)]
    shown = [(media, speed) for _, media, speed in edits if media >= 0]
    return len(shown) > 1 or any(speed != _NORMAL for _, speed in shown)
