"""The Gaussians in a sensor's region, and the rigid body as which it is measured."""

from collections.abc import Mapping, Sequence

import numpy as np

from tg4mm.capture import load_capture
from tg4mm.core.phasors import scale_top
from tg4mm.core.regions import Scale
from tg4mm.core.regions import inside as inside_of
from tg4mm.fit.motion.jacobian.view import blend_sum
from tg4mm.fit.motion.observations import PosedFrames, frames_of
from tg4mm.run import Run
from tg4mm.show.measure.rigid import RigidBody
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensors import OF_PICTURE, STILL, MeasureError, Sensor

_LEAST_SHARE = 0.05  # of a pixel region's largest blending weight: Gaussians with less do not belong to it
_BEHIND = 3.0  # radii of a pixel region: the depth that its surface may span
_SAME_SCALE = 0.1  # by which two lengths in one scene may differ
_SEEN = 1e-3  # pixels of blending weight that a region must have
OF_ONE_CAMERA = "right", "up", "sight"


def weights_of(sensor: Sensor, scene: Prepared, clusters: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return how much each Gaussian belongs to the sensor, [N] float32, 0 … 1. `clusters`: indices by number.

    Raises MeasureError for an empty region, one that no picture shows, and an unknown camera or cluster.
    """
    means = scene.means
    if sensor.region == "all":
        out = np.ones(len(means))
    elif sensor.region in ("box", "sphere"):
        out = _inside(sensor, means)
    elif sensor.region == "cluster":
        out, number = np.zeros(len(means)), int(sensor.values[0])
        if number not in clusters:
            there = ", ".join("still" if k == STILL else str(k) for k in sorted(clusters)) or "none"
            raise MeasureError(f"sensor {sensor}: there is no such cluster; there are: {there}")
        out[clusters[number]] = 1
    else:
        out = _of_pixel(sensor, scene)
    weights = np.asarray(out, np.float32)
    if not weights.any() and sensor.region in OF_PICTURE:
        raise MeasureError(f"sensor {sensor}: its pixels show the background; choose a pixel on a surface")
    _check_holds(sensor, means, weights)
    if float(weights @ scene.seen) < _SEEN:
        raise MeasureError(
            f"sensor {sensor}: no camera whose pictures show motion sees its {int((weights > 0).sum())} Gaussians"
        )
    return weights


def body_of(weights: np.ndarray, scene: Prepared) -> tuple[RigidBody, tuple[str, ...]]:
    """Return the rigid body of a region, and its axes' names: x, y, z, or right, up, sight for one fixed camera.

    `sight` is the line of sight to the region's centre, away from the camera: motion along it is hardly visible.
    """
    seen = weights * scene.seen
    centre = (seen @ scene.means) / seen.sum()
    away = np.linalg.norm(scene.means - centre, axis=1)
    radius = float(np.sqrt((seen @ away**2) / seen.sum()))
    radius = max(radius, float(scene.gaussians.scales.numpy()[weights > 0].mean()))
    if scene.is_moving or len(scene.views) > 1:
        return RigidBody(weights, centre, radius, np.eye(3)), ("x", "y", "z")
    frames = scene.views[0].frames
    viewmat = frames.viewmat.astype(np.float64)
    return RigidBody(weights, centre, radius, sight_axes(viewmat, centre)), OF_ONE_CAMERA


def plane_axes(scale: Scale | None, frames: PosedFrames, centre: np.ndarray) -> np.ndarray:
    """Return the axes [2, 3] of a flat capture: its motion for a unit right and up on its plane.

    With a rectangle marked in the picture a unit is `scale.reference_m` × the focal length, in metres, on the
    rectangle's plane; without one it is that of the picture.
    """
    viewmat = frames.viewmat[:2, :3].astype(np.float64)
    flip = np.array([[1.0, 0.0], [0.0, -1.0]])
    if scale is None or not scale.corners:
        return np.asarray(flip @ viewmat)
    x, y, depth = frames.K.astype(np.float64) @ (frames.viewmat[:3, :3] @ centre + frames.viewmat[:3, 3])
    pixels = np.linalg.inv(scale.metres_at((float(x / depth), float(y / depth)))) * scale.reference_m
    return np.asarray(flip @ pixels.T @ viewmat)


def plane_depth(scene: Prepared, weights: np.ndarray | None = None) -> float:
    """Return the distance of a flat capture's plane from the camera, scene units.

    weights [N]: of the Gaussians that show it; without them, or without any Gaussian, the complete plane's.
    """
    frames = scene.observations.frames[0]
    if not len(scene.means):
        return float(frames.K[0, 0])
    seen = scene.seen if weights is None or not (weights @ scene.seen) > 0 else weights * scene.seen
    return float(np.average(scene.means @ frames.viewmat[2, :3] + frames.viewmat[2, 3], weights=seen))


def px_per_unit(frames: PosedFrames, centre: np.ndarray) -> float:
    """Return pixels per scene unit at a place; 0 behind the camera."""
    depth = float(frames.viewmat[2, :3] @ centre + frames.viewmat[2, 3])
    return float(frames.K[0, 0]) / depth if depth > 0 else 0.0


def unit_scale(scale: Scale, scene: Prepared) -> float:
    """Return metres per scene unit from the marks in the one fixed camera's picture; depths are the model's.

    Raises MeasureError for several cameras, a moving one, an end on the background, or a dataset of another scale.
    """
    if scene.is_moving or len(scene.observations.frames) != 1:
        raise MeasureError("a scale marked in a picture needs one fixed camera: give tg4mm sfm --length")
    if not scene.capture.kind.sees_depth:
        return scale.reference_m * float(scene.observations.frames[0].K[0, 0] / plane_depth(scene))
    if not scale.lengths:
        raise MeasureError("a rectangle gives the scale of flat captures only; mark a length instead")
    found = []
    for first, last, metres in scale.lengths:
        ends = [_point_at(scene, at) for at in (first, last)]
        found.append(metres / float(np.linalg.norm(ends[1] - ends[0])))
    known = [scene.capture.unit_scale_m] if scene.capture.unit_scale_m is not None else []
    every = [*found, *known]
    if max(every) > (1 + _SAME_SCALE) * min(every):
        raise MeasureError(f"two lengths disagree: {max(every):.4g} and {min(every):.4g} m per scene unit")
    return known[0] if known else float(np.mean(found))


def _point_at(scene: Prepared, at: tuple[float, float]) -> np.ndarray:
    """Return the position [3] that is seen at a pixel of the one view."""
    sensor = Sensor("end", "pixel", (*at, 1.5), scene.observations.frames[0].name)
    check_pixel(sensor, [sensor.camera], scene.observations.size)
    weights = _of_pixel(sensor, scene)
    if not weights.any():
        raise MeasureError(f"a length's end at pixel {at[0]:g}, {at[1]:g} shows the background")
    frames = scene.views[0].frames
    viewmat, K = frames.viewmat.astype(np.float64), frames.K.astype(np.float64)
    depth = scale_top(scene.means @ viewmat[2, :3] + viewmat[2, 3], weights, 0.5)
    x = np.linalg.solve(K, [*at, 1.0]) * depth
    return np.asarray(viewmat[:3, :3].T @ (x - viewmat[:3, 3]))


def sight_axes(viewmat: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the rows [3, 3]: the picture's right and up as seen at `centre`, and the line of sight."""
    sight = viewmat[:3, :3].T @ viewmat[:3, 3] + centre
    sight = sight / np.linalg.norm(sight)
    right = viewmat[0, :3] - (viewmat[0, :3] @ sight) * sight
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, sight), sight])


def check_sensors(run: Run, sensors: Sequence[Sensor]) -> None:
    """Check sensors before pictures are read. Raises MeasureError for a region that the run does not have."""
    capture = load_capture(run.dataset, split="train")
    names, size = [f.name for f in frames_of(capture)[1]], (capture.width, capture.height)
    means = run.load_space().means.numpy().astype(np.float64)
    for sensor in sensors:
        if sensor.region in OF_PICTURE:
            check_pixel(sensor, names, size)
        elif sensor.region in ("box", "sphere"):
            _check_holds(sensor, means, _inside(sensor, means))


def check_pixel(sensor: Sensor, cameras: Sequence[str], size: tuple[int, int]) -> None:
    """Raise MeasureError for an unknown camera, or a pixel outside the picture of `size` (w, h)."""
    if sensor.camera not in cameras:
        known = ", ".join(cameras[:8]) + (" …" if len(cameras) > 8 else "")
        raise MeasureError(f"sensor {sensor}: {sensor.camera!r} is not a camera; cameras: {known}")
    x, y = np.mean(corners_of(sensor), 0)
    if not (0 <= x <= size[0] and 0 <= y <= size[1]):
        raise MeasureError(
            f"sensor {sensor}: pixel {x:g}, {y:g} lies outside the picture of {size[0]}×{size[1]}"
        )


def corners_of(sensor: Sensor) -> np.ndarray:
    """Return a polygon's corners [P, 2] in pixels, or the pixel itself."""
    values = sensor.values[:2] if sensor.region == "pixel" else sensor.values
    return np.array(values).reshape(-1, 2)


def _inside(sensor: Sensor, means: np.ndarray) -> np.ndarray:
    """Return whether each mean [N, 3] lies in a box or a sphere."""
    if sensor.region == "sphere":
        away = np.linalg.norm(means - np.array(sensor.values[:3]), axis=1)
        return np.asarray(away <= sensor.values[3])
    low, high = np.array(sensor.values[:3]), np.array(sensor.values[3:])
    return np.asarray(((means >= low) & (means <= high)).all(1))


def _check_holds(sensor: Sensor, means: np.ndarray, weights: np.ndarray) -> None:
    if not weights.any():
        low, high = (", ".join(f"{v:.3g}" for v in np.percentile(means, p, axis=0)) for p in (1, 99))
        span = f"from ({low}) to ({high})"
        raise MeasureError(f"sensor {sensor}: holds no Gaussian; the scene reaches {span} scene units")


def _of_pixel(sensor: Sensor, scene: Prepared) -> np.ndarray:
    """Return the surface seen around a pixel: Gaussians by the part of them that blends into the neighbourhood."""
    names = [f.name for f in scene.observations.frames]
    check_pixel(sensor, names, scene.observations.size)
    view = scene.views[names.index(str(sensor.camera))]
    height, width = view.mean.shape[:2]
    corners = corners_of(sensor)
    if sensor.region == "pixel":
        (x, y), radius = corners[0], sensor.values[2]
        rows, columns = np.mgrid[:height, :width] + 0.5
        near = ((columns - x) ** 2 + (rows - y) ** 2 <= max(radius, 0.75) ** 2).astype(np.float32)
    else:
        near = inside_of(corners, (width, height))
        radius = float(np.sqrt(near.sum() / np.pi))
    inside, whole = blend_sum(view.view, np.stack([near, np.ones_like(near), near], -1))[:, :2].T
    inside = np.maximum(inside, 0)
    viewmat, focal = view.frames.viewmat.astype(np.float64), float(view.frames.K[0, 0])
    depth = scene.means @ viewmat[2, :3] + viewmat[2, 3]
    at = scale_top(depth, inside, 0.5)
    inside[np.abs(depth - at) > _BEHIND * max(radius, 1.0) * at / focal] = 0  # large haze in front, too
    out = np.where(inside > _LEAST_SHARE * inside.max(), inside / np.maximum(whole, 1e-12), 0)
    return np.minimum(2 * out, 1)
