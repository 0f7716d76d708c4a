"""Which frames of a moving camera are sharp, and those frames as picture files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from tg4mm.capture.sfm.clip import WHOLE, Clip, Window, clip_frames
from tg4mm.core.files import write_atomic
from tg4mm.core.progress import progress

KEYS = 80  # sharp frames that poses are first found from, at most
SWEEP_FRAMES = 60  # of a video of the scene at rest


def save_png(path: Path, pixels: np.ndarray, level: int = 1) -> None:
    """Write pixels [H, W, 3 or 4] uint8 as a PNG, whole or not at all. level: of compression, 0 to 9."""
    image = Image.fromarray(pixels)
    write_atomic(path, lambda temporary: image.save(temporary, format="PNG", compress_level=level))


def sharp_rows(sharpness: np.ndarray, most: int) -> np.ndarray:
    """Indices of the sharpest frame in each of equally long windows; at most `most`, and no more than every second."""
    n = len(sharpness)
    windows = np.array_split(np.arange(n), max(1, min(most, -(-n // 2))))
    return np.array([window[int(np.argmax(sharpness[window]))] for window in windows])


def extract_frames(
    clip: Clip, folder: Path, window: Window = WHOLE, rows: Iterable[int] | None = None, total: int = 0
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
