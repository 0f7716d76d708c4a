"""The targets of the static Gaussians: one picture per camera, its mean over time; and the space stage's own unit.

In that unit cameras are DISTANCE away from the middle of what they see, whatever unit the scene is in.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import torch

from tg4mm.capture import Capture, ImageStack, SurfacePoints
from tg4mm.capture.cameras import middle_distance, relative_to
from tg4mm.capture.frames import frame_of, read_ahead
from tg4mm.capture.pictures import FilePictures, mask_of
from tg4mm.core.pictures.decode import THREADS
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space.view import DISTANCE

# Places are rounded to this: a scene written in another unit, or elsewhere, then gives the same bits nearly always.
# Seen from DISTANCE it is a four-millionth of a radian.
_GRAIN = 2.0**-20


@dataclass(frozen=True)
class RestViews:
    """V cameras and their mean pictures, composited over white."""

    viewmats: np.ndarray  # [V, 4, 4] float32 or float64
    Ks: np.ndarray  # [V, 3, 3] float32
    rgb: np.ndarray  # [V, H, W, 3] float32 in 0..1; NaN where no picture counts (`capture/pictures.py`)
    alpha: np.ndarray  # [V, H, W] float32 in 0..1
    images: tuple[np.ndarray, ...]  # for each camera, the rows of the capture it took

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.rgb.shape[2], self.rgb.shape[1]


def rest_views(capture: Capture, images: ImageStack | FilePictures) -> RestViews:
    """Group the images by camera and average each group. Cameras come in order of their first image.

    Each picture is decoded once; of those on disk few are in memory at a time.
    """
    _, first = np.unique(capture.camera_ids, return_index=True)
    first = np.sort(first)
    groups = [np.flatnonzero(capture.camera_ids == capture.camera_ids[i]) for i in first]
    rgb = np.empty((len(groups), capture.height, capture.width, 3), np.float32)
    alpha = np.empty(rgb.shape[:3], np.float32)
    done = 0
    with progress("mean pictures", len(capture), "pictures", brief=True) as update:
        pictures = _in_turn(images, np.concatenate(groups))
        for v, group in enumerate(groups):
            total = _Sum(rgb.shape[1:3], images.maximum)
            for picture in islice(pictures, len(group)):
                total.add(picture)
                update(done := done + 1)
            rgb[v], alpha[v] = total.means(len(group))
            if capture.masks:
                rgb[v] = _masked_mean(capture, images, group, rgb[v])
    return RestViews(
        viewmats=capture.viewmats[first],
        Ks=capture.Ks[first].astype(np.float32),
        rgb=rgb,
        alpha=alpha,
        images=tuple(groups),
    )


def _masked_mean(
    capture: Capture, images: ImageStack | FilePictures, group: np.ndarray, mean: np.ndarray
) -> np.ndarray:
    """Return [H, W, 3]: the mean over the pictures that count at each pixel, NaN where none does."""
    masks = [mask_of(capture, int(i)) for i in group]
    if all(mask is None for mask in masks):
        return mean
    total, count = np.zeros(mean.shape), np.zeros(mean.shape[:2])
    for i, mask in zip(group, masks, strict=True):
        counts = np.ones(mean.shape[:2], bool) if mask is None else mask
        total += images.rgb(int(i)) * counts[..., None]
        count += counts
    masked_mean = total / np.maximum(count, 1)[..., None]
    return np.where(count[..., None] > 0, masked_mean, np.nan).astype(np.float32)


def _in_turn(images: ImageStack | FilePictures, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Pictures as stored, some decoded in advance: files by several threads, a video's frames by one, in order."""
    if isinstance(images, FilePictures) and any(map(frame_of, images.capture.paths)):
        yield from read_ahead(map(images.stored, rows.tolist()))
        return
    with ThreadPoolExecutor(THREADS) as pool:
        for begin in range(0, len(rows), THREADS):
            yield from pool.map(images.stored, rows[begin : begin + THREADS].tolist())


class _Sum:
    """Pictures of one size over white, added up in whole numbers: exactly, in any order."""

    def __init__(self, size: tuple[int, ...], maximum: int) -> None:
        self._maximum = maximum  # the stored value that means 1
        kind = np.uint32 if maximum < 256 else np.uint64  # the former takes 66,000 pictures of 8 bits
        self._opaque: np.ndarray = np.zeros((*size, 4), kind)  # opaque pictures, in units of 1 / maximum
        self._colour: np.ndarray = np.zeros((*size, 3), kind)  # the others, in units of 1 / maximum²
        self._alpha: np.ndarray = np.zeros(size, np.uint32)  # in units of 1 / maximum

    def add(self, picture: np.ndarray) -> None:
        """picture: [H, W, 4] as stored, straight alpha."""
        alpha = picture[..., 3:]
        if alpha.min() == self._maximum:
            self._opaque += picture
            return
        colour = picture[..., :3].astype(self._colour.dtype)
        self._alpha += alpha[..., 0]
        colour *= alpha
        colour += (self._maximum - alpha).astype(colour.dtype) * colour.dtype.type(self._maximum)
        self._colour += colour

    def means(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Colour [H, W, 3] and alpha [H, W] in 0..1 of so many pictures."""
        colour = self._colour + self._opaque[..., :3] * self._colour.dtype.type(self._maximum)
        alpha = self._alpha + self._opaque[..., 3]
        return colour / (count * self._maximum**2), alpha / (count * self._maximum)


@dataclass(frozen=True)
class SceneUnit:
    """x = centre + unit · x', with x in the scene's unit and x' in the stage's."""

    centre: np.ndarray  # [3] float64, scene units
    unit: float  # scene units

    @classmethod
    def of(cls, views: RestViews, points: SurfacePoints | None) -> "SceneUnit":
        """Compute the unit from the cameras or, if they share one position, from the points."""
        xyz = None if points is None else points.xyz
        centre, distance = middle_distance(views.viewmats, views.Ks, views.size, xyz)
        return cls(centre, distance / DISTANCE)

    def views(self, views: RestViews) -> RestViews:
        """Views from the same cameras, float32."""
        moved = relative_to(views.viewmats.astype(np.float64), self.centre)
        moved[:, :3, 3] = _rounded(moved[:, :3, 3] / self.unit)
        return replace(views, viewmats=moved.astype(np.float32), Ks=views.Ks.astype(np.float32))

    def points(self, points: SurfacePoints | None) -> SurfacePoints | None:
        """The same points, float32."""
        if points is None:
            return None
        xyz = _rounded((points.xyz.astype(np.float64) - self.centre) / self.unit)
        return replace(points, xyz=xyz.astype(np.float32))

    def back(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians in scene units, float32."""
        means = gaussians.means.double() * self.unit + torch.from_numpy(self.centre)
        scales = gaussians.scales.double() * self.unit
        return replace(gaussians, means=means.float(), scales=scales.float())


def _rounded(places: np.ndarray) -> np.ndarray:
    return np.asarray(np.round(places / _GRAIN) * _GRAIN)
