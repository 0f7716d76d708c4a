"""H.264 video for browsers: yuv420p, even sizes, BT.709, repeated to last some seconds."""

import contextlib
import errno
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

import numpy as np

from tg4mm.core.errors import ROOM, RunError
from tg4mm.core.files import write_atomic
from tg4mm.core.pictures.decode import read_png
from tg4mm.core.progress import progress

_RATES = (0.01, 10_000.0)  # pictures a second; limits of encoder and players

# Ctrl+C must reach only this program, which ends the encoder.
_SEPARATE_GROUP: dict[str, Any] = (
    {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}
    if sys.platform == "win32"
    else {"start_new_session": True}
)


def check_rate(fps: float) -> None:
    """Raise RunError for a rate, in pictures a second, that no video can have."""
    if not _RATES[0] <= fps <= _RATES[1]:
        raise RunError(
            f"a video of {fps:g} pictures a second: expected {_RATES[0]:g} … {_RATES[1]:g}; see --slow and --no-video"
        )


def loops_to_last(n_frames: int, fps: float, seconds: float) -> int:
    """Return how often `n_frames` at `fps` must be repeated to last at least `seconds`."""
    return max(1, math.ceil(seconds * fps / max(n_frames, 1) - 1e-9))


def even_size(image: np.ndarray) -> np.ndarray:
    """Return the picture [H, W, 3] with its last row or column repeated if a side is odd (yuv420p needs even)."""
    height, width = image.shape[:2]
    if not (height % 2 or width % 2):
        return image
    return np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def write_mp4(
    path: Path, frames: Sequence[np.ndarray], fps: float, loops: int = 1, scale: int = 1, quality: int = 17
) -> None:
    """Write uint8 pictures [H, W, 3] of one size as mp4, `loops` times over; `fps` in frames per second.

    `scale` enlarges by an integer (bicubic), since 4:2:0 chroma would smear small pictures. `quality` is x264's
    constant rate factor, smaller is better.
    """
    if not len(frames):
        raise RunError(f"{path}: no frames to write")
    check_rate(fps)
    shapes = {frame.shape for frame in frames}
    if len(shapes) > 1:
        raise RunError(f"{path}: frames of different sizes {sorted(shapes)}")
    if frames[0].dtype != np.uint8:
        raise ValueError(f"frames are {frames[0].dtype}, expected uint8")
    path.parent.mkdir(parents=True, exist_ok=True)
    prepared = [even_size(frame) for frame in frames] * loops
    size = prepared[0].shape[1], prepared[0].shape[0]
    count = len(prepared)
    write_atomic(path, lambda temporary: _encode(temporary, prepared, count, size, fps, scale, quality))


def stream_mp4(
    path: Path, frames: Iterable[np.ndarray], size: tuple[int, int], fps: float, count: int
) -> None:
    """Write an mp4 of `count` pictures from an iterator, all of `size` (width, height), even pixels."""
    check_rate(fps)
    if size[0] % 2 or size[1] % 2:
        raise ValueError(f"size is {size[0]}×{size[1]}, expected even numbers")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, lambda temporary: _encode(temporary, frames, count, size, fps))


def _encode(
    path: Path,
    frames: Iterable[np.ndarray],
    count: int,
    size: tuple[int, int],
    fps: float,
    scale: int = 1,
    quality: int = 17,
    label: str = "video",
) -> None:
    """Encode to a file. Raises RunError unless the encoder ends well; only its exit status shows a full disk."""
    import imageio_ffmpeg

    width, height = size
    filters = f"scale={width * scale}:{height * scale}:flags=bicubic:out_color_matrix=bt709:out_range=tv"
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        *("-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"),
        *("-r", str(Fraction(fps).limit_denominator()), "-i", "-", "-an"),
        *("-c:v", "libx264", "-pix_fmt", "yuv420p", "-vf", filters, "-crf", str(quality), "-preset", "fast"),
        *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-threads", "2"),
        *("-movflags", "+faststart", "-f", "mp4"),  # the temporary name does not end in .mp4
        f"file:{path}",
    ]
    with (
        progress(label, count, "pictures", brief=label == "video") as update,
        tempfile.TemporaryFile() as messages,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=messages, **_SEPARATE_GROUP
        ) as encoder,
    ):
        assert encoder.stdin is not None
        try:
            for done, frame in enumerate(frames, 1):
                encoder.stdin.write(np.ascontiguousarray(frame).data)
                update(done)
            encoder.stdin.close()
            status = encoder.wait()
        except OSError:  # it ended before the last picture
            with contextlib.suppress(OSError):
                encoder.stdin.close()
            status = encoder.wait()
        except BaseException:
            encoder.kill()
            raise
        errors = _errors(messages)
        if status or errors:
            remedy = f"; {ROOM}" if os.strerror(errno.ENOSPC) in errors else ""
            raise RunError(
                f"{path.parent}: no video could be written, ffmpeg ended with {status}: {errors}{remedy}"
            )


def _errors(messages: IO[bytes]) -> str:
    """Return the last line of the encoder's messages, without its origin."""
    messages.seek(0)
    lines = messages.read().decode(errors="replace").strip().splitlines()
    return lines[-1].partition("] ")[2] or lines[-1] if lines else ""


def video_of_files(path: Path, pictures: Sequence[Path], fps: float) -> None:
    """Write an mp4 of picture files in order, as `video_of`."""
    height, width = read_png(pictures[0]).shape[:2]
    video_of(path, map(read_png, pictures), (width, height), len(pictures), fps)


def video_of(
    path: Path,
    pictures: Iterable[np.ndarray],
    size: tuple[int, int],
    count: int,
    fps: float,
    label: str = "video",
    seconds: float = 4.0,
) -> None:
    """Write an mp4 of `count` pictures of one size (width, height), each encoded when it comes.

    They are repeated to last at least `seconds`; small ones are enlarged.
    """
    check_rate(fps)
    loops = loops_to_last(count, fps, seconds)
    frames = pictures if loops == 1 else [*pictures] * loops
    scale = max(1, math.ceil(256 / max(size)))
    even = size[0] + size[0] % 2, size[1] + size[1] % 2

    def prepared() -> Iterator[np.ndarray]:
        for frame in frames:
            if frame.shape[1::-1] != size:
                raise RunError(f"{path}: frames of different sizes {sorted({frame.shape[1::-1], size})}")
            yield even_size(frame)

    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(
        path, lambda temporary: _encode(temporary, prepared(), loops * count, even, fps, scale, label=label)
    )
