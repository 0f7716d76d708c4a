"""Videos as bytes to embed in a page."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np

from tg4mm.render.video import loops_to_last, write_mp4


def clip(frames: np.ndarray, fps: float, seconds: float = 4.0, edge: int = 384) -> bytes:
    """An mp4 of uint8 frames [T, H, W, 3], repeated to last `seconds`; small ones are enlarged."""
    scale = max(1, math.floor(edge / max(frames.shape[1:3]) + 0.5))
    with tempfile.TemporaryDirectory(prefix="tg4mm-") as folder:
        path = Path(folder) / "clip.mp4"
        write_mp4(path, list(frames), fps, loops_to_last(len(frames), fps, seconds), scale, quality=20)
        return path.read_bytes()
