"""The frames of a video as pictures in a folder, through imageio's ffmpeg."""

from __future__ import annotations

import math
import os
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.errors import CaptureError
from tg4mm.progress import progress


def video_fps(path: Path) -> float:
    """Frames per second as the file says. Raises CaptureError where it is no video or does not say."""
    fps = float(_opened(path)[1].get("fps") or 0)
    if not math.isfinite(fps) or fps <= 0:
        raise CaptureError(f"{path}: does not say its frames per second; give --fps")
    return fps


def extract_frames(path: Path, folder: Path, most: int | None = None) -> tuple[Path, ...]:
    """folder/00000.png …, every frame of the video, or `most` of them evenly over its length.

    The folder appears when it is complete; one that is there is taken as it is.
    """
    if not folder.is_dir():
        total = _count(path)
        wanted = _even(total, most) if most is not None and total > most else None
        temporary = folder.with_name(f".{folder.name}.tmp")
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        frames, meta = _opened(path)
        width, height = meta["size"]
        with progress(f"frames of {path.name}", total, "frames") as update:
            for i, data in enumerate(frames):
                if wanted is None or i in wanted:
                    picture = np.frombuffer(data, np.uint8).reshape(height, width, 3)
                    Image.fromarray(picture).save(temporary / f"{i:05d}.png", compress_level=1)
                update(min(i + 1, total))
        if not any(temporary.iterdir()):
            raise CaptureError(f"{path}: holds no frames")
        os.replace(temporary, folder)
    return tuple(sorted(folder.glob("*.png")))


def _count(path: Path) -> int:
    import imageio_ffmpeg

    try:
        return imageio_ffmpeg.count_frames_and_secs(str(path))[0]
    except (OSError, RuntimeError) as error:  # whose text is ffmpeg's whole output
        raise CaptureError(f"{path}: is not a video that ffmpeg can read") from error


def _even(total: int, most: int) -> set[int]:
    return set(np.linspace(0, total - 1, most).round().astype(int).tolist())


def _opened(path: Path):
    """The generator of frames (bytes, RGB) and what ffmpeg says of the video."""
    import imageio_ffmpeg

    frames = imageio_ffmpeg.read_frames(str(path))
    try:
        return frames, next(frames)
    except (OSError, RuntimeError, StopIteration, KeyError) as error:
        raise CaptureError(f"{path}: is not a video that ffmpeg can read") from error
