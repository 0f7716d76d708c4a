"""The pictures of a capture as one video for each camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.core.pictures.decode import decode
from tg4mm.research.bench.errors import BenchError
from tg4mm.research.evaluate.scores import BACKGROUND


def cameras_of(capture: Capture) -> list[np.ndarray]:
    """For each camera the indices of its images in order of time."""
    found = []
    for camera in np.unique(capture.camera_ids):
        rows = np.flatnonzero(capture.camera_ids == camera)
        found.append(rows[np.argsort(capture.timesteps[rows], kind="stable")])
    return found


def most_changing(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """(indices of its images in order of time, their video) of the camera whose pictures vary most over time."""
    videos = ((rows, video_of(capture, rows)) for rows in cameras_of(capture))
    return max(videos, key=lambda found: float(found[1].var(0).mean()))


def picture_name(capture: Capture, image: int) -> Path:
    """Where a method's picture of an image lies in its folder: as the image in the dataset, but always a PNG."""
    return capture.paths[image].relative_to(capture.root).with_suffix(".png")


def video_of(capture: Capture, rows: np.ndarray, root: Path | None = None) -> np.ndarray:
    """[T, H, W, 3] float32 in 0..1 over white: the images `rows`, or a method's pictures of them under
    `root`.

    Raises BenchError for a file that is not there, leads out of `root` or has another size, CaptureError for a torn
    one.
    """
    frames = []
    for i in rows.tolist():
        path = capture.paths[i]
        if root is not None:
            path = root / picture_name(capture, i)
            if not path.is_file():
                raise BenchError(f"{path} does not exist: every picture of the test split is needed")
            if not path.resolve().is_relative_to(root.resolve()):
                raise BenchError(f"{path} leads out of its folder, to {path.resolve()}")
        image = decode(path)
        if image.shape[:2] != (capture.height, capture.width):
            size = f"{image.shape[1]}×{image.shape[0]}"
            raise BenchError(f"{path}: is {size} pixels, expected {capture.width}×{capture.height}")
        frames.append(ImageStack(image[None]).rgb(0, background=BACKGROUND))
    return np.stack(frames)
