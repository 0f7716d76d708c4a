"""Videos as bytes to embed in a page."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.show.render.video import loops_to_last, write_mp4

_MOST = 2_500_000  # bytes of one clip
_LARGEST, _SMALLEST = 720, 240  # pixels of the longer side
_SCREEN = 60.0  # pictures a second that a screen shows
_SLOWED = 30.0


def playing_rate(fps: float) -> float:
    """Pictures a second that a record is shown at: its own, slower where a screen could not follow."""
    return fps if fps <= _SCREEN else _SLOWED


def clip(frames: np.ndarray, fps: float, seconds: float = 4.0, edge: int = 384) -> bytes:
    """An mp4 of uint8 frames [T, H, W, 3], repeated to last `seconds`; small ones are enlarged, large ones reduced.

    At most 720 pixels a side, and less where the file would be larger than 2.5 MB.
    """
    scale = max(1, math.floor(edge / max(frames.shape[1:3]) + 0.5))
    largest = float(_LARGEST)
    while True:
        data = _encoded(_reduced(frames, largest), fps, seconds, scale)
        if len(data) <= _MOST or largest <= _SMALLEST:
            return data
        largest = max(_SMALLEST, largest * max(0.5, math.sqrt(_MOST / len(data)) * 0.95))


def _encoded(frames: np.ndarray, fps: float, seconds: float, scale: int) -> bytes:
    with tempfile.TemporaryDirectory(prefix="tg4mm-") as folder:
        path = Path(folder) / "clip.mp4"
        write_mp4(path, list(frames), fps, loops_to_last(len(frames), fps, seconds), scale, quality=20)
        return path.read_bytes()


def _reduced(frames: np.ndarray, largest: float) -> np.ndarray:
    height, width = frames.shape[1:3]
    share = largest / max(height, width)
    if share >= 1:
        return frames
    size = max(2, round(width * share)), max(2, round(height * share))
    return np.stack([np.asarray(Image.fromarray(f).resize(size, Image.Resampling.LANCZOS)) for f in frames])
