"""A dataset of one fixed camera and nothing else: the scene is the plane that its picture lies on."""

from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.model import SurfacePoints
from tg4mm.capture.sfm.clip import Clip, Window
from tg4mm.capture.sfm.dataset import Track, write_dataset
from tg4mm.capture.sfm.survey import Survey
from tg4mm.capture.sfm.undistort import Lens
from tg4mm.core.pictures.decode import decode

SPACING = 3  # pixels between points of the plane
# World to camera, OpenCV axes: the camera is at the origin, upright, and looks along +y.
VIEWMAT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def write_flat(
    out: Path, clip: Clip, survey: Survey, times_s: np.ndarray, window: Window, scene: dict[str, Any]
) -> int:
    """Write the clip as a tree of timesteps seen from the origin along +y, the scene being the plane y = 1.

    A pixel is then 1/f of a scene unit with f = max(width, height), `pixels_per_unit`. Returns the number of points.
    """
    width, height = survey.size
    focal = float(max(width, height))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    points = plane_points(decode(survey.mean)[..., :3], focal)
    viewmats = np.tile(VIEWMAT, (len(survey), 1, 1))
    track = Track(clip.name, clip, Lens(K, survey.size, None), viewmats, times_s, window=window)
    write_dataset(out, [track], points, scene | {"pixels_per_unit": focal, "unit_scale_m": None})
    return len(points.xyz)


def plane_points(picture: np.ndarray, focal: float) -> SurfacePoints:
    """A regular grid of points on the plane y = 1 with the colours of picture [H, W, 3] uint8, f in pixels."""
    height, width = picture.shape[:2]
    u, v = np.meshgrid(_centres(width), _centres(height))
    xyz = np.stack([(u - width / 2) / focal, np.ones_like(u), -(v - height / 2) / focal], axis=-1)
    rgb = picture[v.astype(int), u.astype(int)]
    return SurfacePoints(xyz.reshape(-1, 3).astype(np.float32), rgb.reshape(-1, 3))


def _centres(pixels: int) -> np.ndarray:
    """Places some SPACING pixels apart, centred, half of that from both edges."""
    n = max(1, round(pixels / SPACING))
    return (np.arange(n) + 0.5) * pixels / n
