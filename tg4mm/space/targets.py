"""What the static Gaussians are fitted to: one picture per camera, the mean over time.

Averaging over the images of a camera that stays put takes out noise and leaves the mean pose, around which the
motion stage measures; a camera used once is its own mean. A capture of one timestep is the special case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tg4mm.capture import Capture, ImageStack


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


def rest_views(capture: Capture, images: ImageStack) -> RestViews:
    """Group the images by camera and average each group. Cameras come in order of their first image."""
    _, first = np.unique(capture.camera_ids, return_index=True)
    first = np.sort(first)
    groups = [np.flatnonzero(capture.camera_ids == capture.camera_ids[i]) for i in first]
    rgb = np.stack([np.mean([images.rgb(i) for i in group], axis=0, dtype=np.float64) for group in groups])
    alpha = np.stack(
        [np.mean([images.alpha(i) for i in group], axis=0, dtype=np.float64) for group in groups]
    )
    return RestViews(
        viewmats=capture.viewmats[first].astype(np.float32),
        Ks=capture.Ks[first].astype(np.float32),
        rgb=rgb.astype(np.float32),
        alpha=alpha.astype(np.float32),
        images=tuple(groups),
    )
