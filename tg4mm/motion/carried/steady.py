"""Noise that stands still: a sensor's pattern, or that of a renderer which draws the same in every timestep.

It is in the mean over time like a surface's texture, but does not move along, and slopes of which half are noise would
make every motion too small. So slopes count as far as there is more of them around a pixel than noise alone gives
(Wiener's filter). How strong the noise is, is told by what no surface shows: detail of one pixel in both directions.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter

_AROUND = 5  # pixels: edge of the square over which slopes are looked at
# of white noise with variance 1: of a slope by `slopes`, and of a second difference of second differences
_OF_SLOPE = 2 * (8**2 + 1) / 12**2
_OF_DETAIL = 6.0**2
_MEDIAN = 0.6745  # of the magnitude of a normal number, standard deviation 1


def trust(padded: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """[H, W] float32, 0 … 1: how far the slopes of a picture are more than noise.

    padded [H + 4, W + 4, 3]: the picture and two more pixels on every side; shown [H, W] bool: where there is anything,
    the noise is that of these pixels. 1 everywhere if there are none.
    """
    if not shown.any():
        return np.ones(shown.shape, np.float32)
    noise = _OF_SLOPE * _variance(padded, shown)
    power = sum((slope.astype(np.float64) ** 2).mean(-1) for slope in slopes(padded)) / 2
    around = np.maximum(uniform_filter(power, _AROUND), np.finfo(np.float32).tiny)
    return np.maximum(1 - noise / around, 0).astype(np.float32)


def slopes(padded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[H, W, 3] each, to the right and down, to the fourth order: fine detail is what errors are made of."""
    here = slice(2, -2)
    right = 8 * (padded[here, 3:-1] - padded[here, 1:-3]) - (padded[here, 4:] - padded[here, :-4])
    down = 8 * (padded[3:-1, here] - padded[1:-3, here]) - (padded[4:, here] - padded[:-4, here])
    return right / np.float32(12), down / np.float32(12)


def _variance(padded: np.ndarray, shown: np.ndarray) -> float:
    """Of the noise, mean over the channels; by medians, so that edges do not count (Immerkær 1996)."""
    inner = padded[1:-1, 1:-1].astype(np.float64)
    across = inner[:, 2:] - 2 * inner[:, 1:-1] + inner[:, :-2]
    detail = np.abs(across[2:] - 2 * across[1:-1] + across[:-2])[shown]
    return float(((np.median(detail, axis=0) / _MEDIAN) ** 2).mean() / _OF_DETAIL)
