"""What the static Gaussians are fitted to: one picture per camera, the mean over time.

Averaging over the images of a camera that stays put takes out noise and leaves the mean pose, around which the
motion stage measures; a camera used once is its own mean. A capture of one timestep is the special case.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.capture.pictures import FilePictures


@dataclass(frozen=True)
class RestViews:
    """V cameras and their mean pictures, composited over white."""

    viewmats: np.ndarray  # [V, 4, 4] float32
    Ks: np.ndarray  # [V, 3, 3] float32
    rgb: np.ndarray  # [V, H, W, 3] float32 in 0..1
    alpha: np.ndarray  # [V, H, W] float32 in 0..1
    images: tuple[np.ndarray, ...]  # for each camera, the rows of the capture it took

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.rgb.shape[2], self.rgb.shape[1]


def rest_views(capture: Capture, images: ImageStack | FilePictures) -> RestViews:
    """Group the images by camera and average each group. Cameras come in order of their first image.

    One picture at a time is looked at, so pictures on disk take no more memory than two.
    """
    _, first = np.unique(capture.camera_ids, return_index=True)
    first = np.sort(first)
    groups = [np.flatnonzero(capture.camera_ids == capture.camera_ids[i]) for i in first]
    rgb = np.stack([_mean(images.rgb, group) for group in groups])
    alpha = np.stack([_mean(images.alpha, group) for group in groups])
    return RestViews(
        viewmats=capture.viewmats[first].astype(np.float32),
        Ks=capture.Ks[first].astype(np.float32),
        rgb=rgb,
        alpha=alpha,
        images=tuple(groups),
    )


def _mean(of: Callable[[int], np.ndarray], rows: np.ndarray) -> np.ndarray:
    """float32, summed in float64."""
    total = of(int(rows[0])).astype(np.float64)
    for i in rows[1:]:
        total += of(int(i))
    return np.asarray(total / len(rows), np.float32)
