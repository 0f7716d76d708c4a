"""Rows that are read one after another: bands of a picture, each read at a time of its own (docs/method.md).

What a band says of motion is a sum over its pixels, a number for each frame at the band's own times. Bands of one
region are brought to the region's mean time by interpolation of these numbers, over the difference alone; a region of
few rows is not interpolated at all.
"""

import numpy as np

from tg4mm.capture.tracking.bands import bands_of
from tg4mm.core.even_clock import later
from tg4mm.fit.motion.observations import PosedFrames


def by_band(frames: PosedFrames, height: int, series: np.ndarray) -> np.ndarray:
    """[B, R, F]: functions of the frames' times [R, F] at the times of every band."""
    return np.stack(
        [later(frames.times_s, series, band.delay_s) for band in bands_of(frames.readout_s, height)]
    )


def to_middle(frames: PosedFrames, height: int, rows: np.ndarray, sides: np.ndarray) -> None:
    """Brings `sides` [2, F, N, 6] of N Gaussians, each at the time of its row of the picture, to the frames' times.

    rows [N]: pixels from the upper edge.
    """
    for band in bands_of(frames.readout_s, height):
        last = np.inf if band.rows.stop == height else band.rows.stop
        first = -np.inf if band.rows.start == 0 else band.rows.start
        some = np.flatnonzero((rows >= first) & (rows < last))
        if not len(some):
            continue
        for half in sides:
            own = half[:, some]
            half[:, some] = later(frames.times_s, own.reshape(len(own), -1).T, -band.delay_s).T.reshape(
                own.shape
            )
