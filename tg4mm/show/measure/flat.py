"""Sensors of one fixed camera without depth: regions of its picture, measured by `capture/tracking/region.py`.

No Gaussian takes part, so a video needs no training to be measured. Of a trained run, boxes, spheres and clusters are
the pixels that show their Gaussians.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.ndimage import binary_dilation

from tg4mm.capture.frames import read_ahead
from tg4mm.capture.pictures import Strips, grey_over_white
from tg4mm.capture.tracking.region import Frames, RegionMotion, region_motions
from tg4mm.capture.tracking.registration import Box
from tg4mm.capture.tracking.template import GAIN_ERROR
from tg4mm.core.regions import inside as inside_of
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.show.maps import pixel_rows
from tg4mm.show.measure.locate import (
    OF_ONE_CAMERA,
    check_pixel,
    corners_of,
    plane_axes,
    plane_depth,
    px_per_unit,
    weights_of,
)
from tg4mm.show.measure.rigid import Equations, RigidBody
from tg4mm.show.measure.scene import GreyPictures, Prepared
from tg4mm.show.measure.sensors import OF_PICTURE, MeasureError, Sensor
from tg4mm.show.measure.series import Series, series_of
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_features

_AT_ONCE = 32  # frames
_SMALLEST_PX = 0.75  # radius: a smaller disc could lie between the centres of pixels
_FEWEST_PIXELS = 50  # smaller regions are grown, since few pixels do not separate motion from light
_THIRDS = 1 / 3, 2 / 3
_FRAMES_OF_PARTS = 60  # approximate frames for the motion of parts relative to the region
_FEWEST_IN_PART = 24  # pixels of a part of a region, for its unevenness
_TEXTURE = 1e-3  # least grey levels² / px² of a region's pixels


@dataclass(frozen=True)
class FlatSensor:
    """A sensor as a region of the picture."""

    mask: np.ndarray  # [H, W] float32, 0 … 1
    body: RigidBody
    labels: tuple[str, ...]
    motion: RegionMotion
    series: Series
    spread: float  # rms difference of its parts' motion from its own, over that


@dataclass(frozen=True)
class Unevenness:
    """The differences between the motions of a region and of its parts, over its motion; 0 without parts."""

    offset: float = 0.0  # of the mean over the area
    spread: float = 0.0  # standard deviation of the parts
    pixels: float = 1.0

    @property
    def share(self) -> float:
        """Return the relative difference of the region's motion, measured as one body, from the mean over its area.

        Measured so, a region moves as its most textured parts do. How much that differs from the mean is known from
        its parts, but for what is uneven within each: an element of texture covers about nine pixels, and its weight
        varies by as much as its mean, so that N pixels whose shares of the motion spread by s are wrong by s √(9 / N);
        within parts of N / 9 pixels the spread is a third.
        """
        return float(np.hypot(self.offset, self.spread / np.sqrt(self.pixels)))


def flat_sensors(
    scene: Prepared, sensors: Sequence[Sensor], clusters: Mapping[int, np.ndarray], step: Callable[[], None]
) -> list[FlatSensor]:
    """Measure sensors in one pass over the pictures. `step` is called after each.

    Raises MeasureError for a region outside the picture, one that a mask covers, or one without texture.
    """
    frames = scene.observations.frames[0]
    masks = [_mask(sensor, scene, clusters) for sensor in sensors]
    parts_of_each = [_parts(mask) for mask in masks]
    motions = region_motions(read_ahead(_chunks(scene), 1), masks, frames.times_s, frames.readout_s, step)
    every = max(1, len(frames.rows) // _FRAMES_OF_PARTS)
    flat = [part for own in parts_of_each for part in own]
    few = (
        region_motions(_chunks(scene, every), flat, frames.times_s[::every], frames.readout_s) if flat else []
    )
    parts, out = iter(few), []
    for sensor, mask, motion, own in zip(sensors, masks, motions, parts_of_each, strict=True):
        there = [next(parts).shift for _ in own]
        uneven = unevenness(motion.shift[:, ::every], there, [float(part.sum()) for part in own])
        out.append(_measured(scene, sensor, mask, motion, uneven))
    return out


def _parts(mask: np.ndarray) -> list[np.ndarray]:
    """Return nine parts of a region, three by three; none if one would be too small."""
    rows, columns = (
        np.searchsorted(_THIRDS, np.cumsum(mask.sum(axis)) / mask.sum(), side="right") for axis in (1, 0)
    )
    parts = [mask * ((rows == a)[:, None] & (columns == b)) for a in range(3) for b in range(3)]
    return parts if min(np.count_nonzero(part) for part in parts) >= _FEWEST_IN_PART else []


def unevenness(shift: np.ndarray, parts: Sequence[np.ndarray], areas: Sequence[float]) -> Unevenness:
    """Return how a region's motion, shift [2, F, 3], is distributed over its parts, shifts [2, F, 3] with their areas.

    Noise cancels between even and odd frames.
    """
    if not parts:
        return Unevenness()
    whole, *own = (s[..., :2].mean(0) - s[..., :2].mean((0, 1)) for s in (shift, *parts))
    shares = [
        [float((o[k::2] * whole[k::2]).sum() / max((whole[k::2] ** 2).sum(), 1e-30)) for o in own]
        for k in (0, 1)
    ]
    weights = np.array(areas) / sum(areas)
    means = np.array(shares) @ weights
    offset2 = (means[0] - 1) * (means[1] - 1)
    spread2 = float(weights @ ((shares[0] - means[0]) * (shares[1] - means[1])))
    return Unevenness(float(np.sqrt(max(offset2, 0))), float(np.sqrt(max(spread2, 0))), sum(areas))


def _mask(sensor: Sensor, scene: Prepared, clusters: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return [H, W] float32, 0 to 1."""
    width, height = size = scene.observations.size
    frames = scene.observations.frames[0]
    if sensor.region in OF_PICTURE:
        check_pixel(sensor, [frames.name], size)
        corners = corners_of(sensor)
        if sensor.region == "pixel":
            rows, columns = np.mgrid[:height, :width] + 0.5
            away = np.hypot(columns - corners[0, 0], rows - corners[0, 1])
            out = (away <= max(sensor.values[2], _SMALLEST_PX)).astype(np.float32)
        else:
            out = np.asarray(inside_of(corners, size), np.float32)
    elif sensor.region == "all":
        out = np.ones((height, width), np.float32)
    elif not len(scene.means):
        raise MeasureError(
            f"sensor {sensor}: a {sensor.region} needs a trained run; expected pixel, polygon or all"
        )
    else:
        weights = weights_of(sensor, scene, clusters)
        camera = Camera(frames.name, frames.viewmat.astype(float), frames.K.astype(float), width, height)
        shown = render_features(scene.gaussians, weights[:, None], camera)[0][..., 0]
        out = np.where(shown > 0.5 * shown.max(), shown, 0).clip(0, 1).astype(np.float32)
    while 0 < (out > 0).sum() < min(_FEWEST_PIXELS, out.size):
        out = np.maximum(out, binary_dilation(out > 0).astype(np.float32))
    if scene.observations.valid_mask is not None:
        out = out * scene.observations.valid_mask[0]
    if not out.any():
        raise MeasureError(f"sensor {sensor}: covers no valid pixel")
    return out


def _chunks(scene: Prepared, every: int = 1) -> Iterator[Frames]:
    """Grey levels of boxes of every `every`th picture, a few frames at a time."""
    pictures, rows = scene.observations.pictures, scene.observations.frames[0].rows[::every]
    for first in range(0, len(rows), _AT_ONCE):
        some = rows[first : first + _AT_ONCE].tolist()
        if isinstance(pictures, GreyPictures):
            yield partial(_stored_grey, pictures, some)
        else:
            yield partial(_grey, pictures.strips(some), pictures.maximum)


def _stored_grey(pictures: GreyPictures, rows: list[int], box: Box) -> np.ndarray:
    """Return grey levels [f, h, w] of a box of some pictures."""
    return pictures.data[rows[0] : rows[-1] + 1, *box][np.array(rows) - rows[0]].astype(np.float32)


def _grey(decoded: Strips, maximum: int, box: Box) -> np.ndarray:
    """Return grey levels [f, h, w] of a box of some pictures, which are decoded."""
    return grey_over_white(decoded(box[0])[:, :, box[1]], maximum)


def _measured(
    scene: Prepared, sensor: Sensor, mask: np.ndarray, motion: RegionMotion, uneven: Unevenness
) -> FlatSensor:
    frames = scene.observations.frames[0]
    if not np.trace(motion.noise.sum(0)[:2, :2]) > _TEXTURE * float((mask > 0).sum()):
        raise MeasureError(
            f"sensor {sensor}: its pixels have no texture to measure motion by; enlarge or move it"
        )
    body = _body(scene, frames, mask, motion)
    along = _pixels_along(frames, body, scene.observations.size)
    scale = px_per_unit(frames, body.centre)
    change = np.zeros((3, 3))  # pixels of a unit of each unknown
    change[:2, :2], change[2, 2] = along, scale
    normals, noise = (change @ own @ change.T for own in (motion.normals, motion.noise))
    right_hand_sides = np.einsum("ij,hjk,hfk->hfi", change, motion.normals, motion.shift)
    equations = Equations(normals[:, None], noise[:, None], right_hand_sides, np.zeros((2, 3, 3)))
    clock = scene.clocks[0]
    labels = OF_ONE_CAMERA[:2]
    times = clock.times_s + motion.delay_s
    series = series_of(equations, times, body.axes, labels, body.radius, clock.name)
    share = np.hypot(series.model_share, np.hypot(GAIN_ERROR, uneven.share))
    size = np.linalg.norm(series.displacement, axis=1)
    of_model = np.where(motion.hidden[:, None], size.max(), share * size[:, None])
    deviation = np.sqrt(series.noise**2 + of_model**2)
    series = replace(series, model_share=share, deviation=deviation)
    return FlatSensor(mask, body, labels, motion, series, float(np.hypot(uneven.offset, uneven.spread)))


def _body(scene: Prepared, frames: PosedFrames, mask: np.ndarray, motion: RegionMotion) -> RigidBody:
    """Return the region as a rigid body on the plane of the picture."""
    viewmat, K = frames.viewmat.astype(np.float64), frames.K.astype(np.float64)
    weights = np.zeros(len(scene.means), np.float32)
    if len(weights):
        seen = scene.means @ viewmat[:3, :3].T + viewmat[:3, 3]
        at = ((seen @ K.T)[:, :2] / seen[:, 2:]).astype(int)
        inside = ((at >= 0) & (at < mask.shape[::-1])).all(1)
        weights[inside] = mask[at[inside, 1], at[inside, 0]]
    depth = plane_depth(scene, weights)
    ray = np.linalg.solve(K, [*motion.centre_px, 1.0]) * depth
    centre = viewmat[:3, :3].T @ (ray - viewmat[:3, 3])
    axes = plane_axes(scene.scale, frames, centre)
    return RigidBody(weights, centre, motion.radius_px * depth / float(K[0, 0]), axes)


def _pixels_along(frames: PosedFrames, body: RigidBody, size: tuple[int, int]) -> np.ndarray:
    """Return pixels right and down of a unit along each axis, [2, 2], in rows."""
    rows = pixel_rows(body.centre[None], frames.viewmat, frames.K, size)[0][0]
    return np.asarray(body.axes @ rows.T)
