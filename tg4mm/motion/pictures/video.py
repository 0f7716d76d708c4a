"""What a camera that stays put saw over time: its distinct pictures, a strip of rows at a time.

A generator renders a motion state once, and a camera may hand out a picture twice; what is equal to the last bit is
recognised by its hash and then read, kept and multiplied once. Work and memory go by distinct pictures, not timesteps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tg4mm.capture import Capture
from tg4mm.capture.pictures import Pictures, over_white
from tg4mm.errors import CaptureError

STRIP_VALUES = 1 << 23  # float32 values of a strip, 32 MiB; compositing it takes about three times that


@dataclass(frozen=True)
class FixedCamera:
    """A camera that took an image at every timestep from the same place."""

    viewmat: np.ndarray  # [4, 4] float32
    K: np.ndarray  # [3, 3] float32
    rows: np.ndarray  # [T] its image at each timestep, row of the capture


def fixed_cameras(capture: Capture) -> list[FixedCamera]:
    """The cameras with one image at every timestep. Raises CaptureError if there is none."""
    found = []
    for camera in range(int(capture.camera_ids.max()) + 1):
        rows = np.flatnonzero(capture.camera_ids == camera)
        rows = rows[np.argsort(capture.timesteps[rows], kind="stable")]
        if np.array_equal(capture.timesteps[rows], np.arange(capture.n_timesteps)):
            viewmat, K = capture.viewmats[rows[0]], capture.Ks[rows[0]]
            found.append(FixedCamera(viewmat.astype(np.float32), K.astype(np.float32), rows))
    if not found:
        raise CaptureError(
            f"{capture.root}: no camera has one image at each of the {capture.n_timesteps} timesteps "
            "from the same pose, which the motion stage needs"
        )
    return found


@dataclass(frozen=True)
class Video:
    """One camera's S distinct pictures and which of them it saw when."""

    pictures: Pictures
    rows: np.ndarray  # [S] of the capture
    state: np.ndarray  # [T] 0 … S − 1

    @property
    def share(self) -> np.ndarray:
        """[S] float64: part of the time that each picture was seen."""
        return np.bincount(self.state, minlength=len(self.rows)) / len(self.state)

    def strips(self) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Rows of the picture from top to bottom, with all S pictures over white: their mean over time, and less that.

        slice, [rows, W, 3] float32, [S, rows, W, 3] float32: at most `STRIP_VALUES` values, or one row.
        """
        height, width = self.pictures.size
        at_once = max(STRIP_VALUES // (len(self.rows) * width * 3), 1)
        raw = self.pictures.strips(self.rows.tolist())
        for top in range(0, height, at_once):
            rows = slice(top, min(top + at_once, height))
            out = over_white(raw(rows), self.pictures.maximum)
            flat = out.reshape(len(out), -1)
            mean = self.share.astype(np.float32) @ flat
            flat -= mean
            yield rows, mean.reshape(out.shape[1:]), out


def video_of(pictures: Pictures, camera: FixedCamera) -> Video:
    """What a camera saw, equal pictures found."""
    seen: dict[bytes, int] = {}
    state = np.empty(len(camera.rows), np.int64)
    rows: list[int] = []
    for t, row in enumerate(camera.rows):
        digest = pictures.digest(int(row))
        if digest not in seen:
            seen[digest] = len(rows)
            rows.append(int(row))
        state[t] = seen[digest]
    return Video(pictures, np.array(rows), state)
