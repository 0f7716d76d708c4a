"""Cameras: poses and intrinsics from the conventions on disk to those in memory (docs/conventions.md)."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import CaptureError
from tg4mm.core.untrusted import JsonRecord, as_number

RIGID_TOLERANCE = 1e-3  # matrices written with four decimals pass; a scaled or sheared camera does not
NARROWEST = 1e-6  # radians of field of view; below, the focal length grows past any use and to infinity
FARTHEST = 1e9  # scene units; poses in JSON, float64, resolve a ten-millionth of one there
ONE_PLACE = 1e-6  # scene units, or of the distance to the origin if that is larger
DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
# Fields of transforms files that say that a pixel does not look where a pinhole camera's does, unless they are 0, false
# or empty.
OTHER_LENSES = (
    "distortion_params",
    "is_fisheye",
    "equirectangular",
    "orthographic",
    "latlong",
    *(f"ftheta_p{i}" for i in range(5)),
    "rolling_shutter",
)
SMALLEST = 8  # pixels along a side of a picture: fewer have too little texture to resolve motion
_PINHOLE = "the images of a pinhole camera: undistort them first"
FAR = 64.0  # times what the cameras look at is away from them: beyond, float32 loses a thousandth of a pixel


def check_picture_size(where: Any, width: int, height: int) -> None:
    """Raise CaptureError, naming `where`, for pictures too small to show any motion."""
    if min(width, height) < SMALLEST:
        raise CaptureError(
            f"{where}: pictures are {width}×{height} pixels, expected {SMALLEST} or more along each side"
        )


def world_to_camera(c2w: np.ndarray) -> np.ndarray:
    """Return […, 4, 4] rigid camera-to-world with OpenGL axes → world-to-camera with OpenCV axes, the same shape.

    OpenGL: x right, y up, looks along −z. OpenCV: x right, y down, looks along +z.
    """
    rotation = c2w[..., :3, :3] * np.array([1.0, -1.0, -1.0])  # columns are the camera's axes in the world
    inverse = np.swapaxes(rotation, -1, -2)
    w2c = np.zeros_like(c2w)
    w2c[..., :3, :3] = inverse
    w2c[..., :3, 3:] = -inverse @ c2w[..., :3, 3:]
    w2c[..., 3, 3] = 1.0
    return w2c


def read_pose(frame: JsonRecord, key: str = "transform_matrix") -> np.ndarray:
    """Read the frame's camera-to-world [4, 4] float64, rigid, with the rotation nearest to the one in the file."""
    if key not in frame.values:
        raise frame.error(key, "a 4×4 camera-to-world matrix")
    rows = frame.values[key]
    if not (
        isinstance(rows, list) and len(rows) == 4 and all(isinstance(r, list) and len(r) == 4 for r in rows)
    ):
        raise CaptureError(f"{frame.where}: {key} has shape {_shape(rows)}; expected 4×4")
    pose = np.array([[as_number(x) for x in row] for row in rows])
    if not np.isfinite(pose).all():
        bad = next(x for row in rows for x in row if not math.isfinite(as_number(x)))
        raise CaptureError(f"{frame.where}: {key} holds {bad!r}; expected finite numbers")
    check_near(pose, f"{frame.where}: {key}")
    if np.abs(pose[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise CaptureError(f"{frame.where}: {key} is not rigid: its last row is {rows[3]}, not [0, 0, 0, 1]")
    axes = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # axes of 1e300 give inf or NaN: refused below
        deviation = float(np.abs(axes.T @ axes - np.eye(3)).max())
        determinant = float(np.linalg.det(axes))
    if not deviation <= RIGID_TOLERANCE or determinant < 0:
        raise CaptureError(
            f"{frame.where}: {key} is not rigid: its axes deviate from orthonormal by {deviation:.3g}, "
            f"determinant {determinant:.3g}"
        )
    u, _, vt = np.linalg.svd(axes)
    rigid = np.eye(4)
    rigid[:3, :3] = u @ vt
    rigid[:3, 3] = pose[:3, 3]
    return rigid


def check_near(pose: np.ndarray, where: str) -> None:
    """Raise CaptureError for a camera-to-world [4, 4] so far from the origin that positions lose precision."""
    far = float(np.abs(pose[:3, 3]).max())
    if not far <= FARTHEST:
        raise CaptureError(f"{where} lies {far:g} units from the origin; expected at most {FARTHEST:g}")


def distortion_of(frame: JsonRecord, file: JsonRecord) -> dict[str, float]:
    """The coefficients that are not 0, by name: a frame's own, else the file's."""
    records = {key: frame if frame.has(key) else file for key in DISTORTION}
    found = {key: record.number(key) for key, record in records.items() if record.has(key)}
    return {key: value for key, value in found.items() if value}


def read_intrinsics(
    frame: JsonRecord, file: JsonRecord, width: int, height: int, is_bent: bool = False
) -> np.ndarray:
    """K [3, 3] in pixels for an image of width × height: a frame's own values, else the file's.

    fl_x, fl_y, cx, cy, w, h (pixels) as in nerfstudio, else camera_angle_x and camera_angle_y, the horizontal and the
    vertical field of view in radians; with one of both, pixels are square. The principal point is the centre unless
    given. Raises CaptureError, by the field's name, for a lens that is no pinhole's; unless it `is_bent`, also for one
    with distortion.
    """

    def source(key: str) -> JsonRecord | None:
        return frame if frame.has(key) else file if file.has(key) else None

    for key in DISTORTION:
        record = source(key)
        if record is not None and record.number(key) != 0 and not is_bent:
            raise record.error(key, "0: undistort the images first")
    for key in OTHER_LENSES:
        record = source(key)
        if record is not None and np.any(record.values[key]):
            raise record.error(key, _PINHOLE)
    for key, size in (("w", width), ("h", height)):
        record = source(key)
        if record is not None and record.whole(key, 1) != size:
            raise record.error(key, f"{size}, as the image is {width}×{height} pixels")

    def pixels(key: str, default: float, low: float = -math.inf) -> float:
        record = source(key)
        return default if record is None else record.number(key, low=low)

    def focal(key: str, angle_key: str, size: int) -> float | None:
        if source(key) is not None:
            return pixels(key, 0.0, low=0.0)
        if (record := source(angle_key)) is None:
            return None
        return size / (2 * math.tan(record.number(angle_key, low=NARROWEST, high=math.pi) / 2))

    across, down = focal("fl_x", "camera_angle_x", width), focal("fl_y", "camera_angle_y", height)
    if across is None and down is None:
        raise file.error("camera_angle_x", f"a finite number above {NARROWEST:g} and below {math.pi:g}")
    f_x, f_y = across or down, down or across
    return np.array([[f_x, 0, pixels("cx", width / 2)], [0, f_y, pixels("cy", height / 2)], [0, 0, 1]])


def camera_ids(viewmats: np.ndarray, Ks: np.ndarray) -> np.ndarray:
    """Return [C] int64: one number per distinct camera (pose and intrinsics exactly equal), by first appearance."""
    rows = np.concatenate([viewmats.reshape(-1, 16), Ks.reshape(-1, 9)], axis=1) + 0.0  # -0.0 equals 0.0
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse.reshape(-1)]


def check_depth_observable(where: Path, viewmats: np.ndarray, camera_ids: np.ndarray) -> None:
    """Raise CaptureError, naming `where`, if several cameras all stand at one place: they do not show distances.

    Shapes: viewmats [C, 4, 4], camera_ids [C].
    """
    poses = viewmats[np.unique(camera_ids, return_index=True)[1]]
    centres = -np.einsum("cji,cj->ci", poses[:, :3, :3], poses[:, :3, 3])
    spread = float(np.ptp(centres, axis=0).max())
    if len(poses) > 1 and spread <= ONE_PLACE * max(1.0, float(np.abs(centres).max())):
        raise CaptureError(
            f"{where}: all {len(poses)} cameras stand at one place, which does not show how far things are: "
            "film from several places, or keep the pictures of one camera alone"
        )


def _shape(rows: Any) -> str:
    if not isinstance(rows, list):
        return f"none ({type(rows).__name__})"
    inner = {len(r) if isinstance(r, list) else 0 for r in rows}
    return f"{len(rows)}×{inner.pop()}" if len(inner) == 1 else f"{len(rows)} rows of unequal length"


def optical_axes(viewmats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera centres and unit viewing directions, both [C, 3] float64 in the world, of viewmats [C, 4, 4]."""
    viewmats = viewmats.astype(np.float64)
    centres = -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])
    return centres, viewmats[:, 2, :3]


def nearest_point_equations(centres: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A [3, 3] and b [3] of the normal equations A x = b of the point x nearest to all axes (least squares).

    A is singular where the axes are parallel; the caller decides what happens then.
    """
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # removes what lies along each axis
    return across.sum(0), np.einsum("cij,cj->i", across, centres)


def relative_to(viewmats: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """World-to-camera [C, 4, 4] float64 of the same cameras, in a world whose origin was at `origin` [3]."""
    if not np.any(origin):
        return viewmats
    centres, _ = optical_axes(viewmats)
    moved = viewmats.copy()
    moved[:, :3, 3] = -np.einsum("cij,cj->ci", viewmats[:, :3, :3], centres - origin)
    return moved


def far_origin(
    viewmats: np.ndarray, Ks: np.ndarray, size: tuple[int, int], xyz: np.ndarray | None
) -> np.ndarray:
    """Return the best origin [3] of coordinates: 0, or a rounded position inside a scene far from 0.

    Arguments as `middle_distance` takes them.
    """
    centre, distance = middle_distance(viewmats, Ks, size, xyz)
    origins, _ = optical_axes(viewmats)
    reach = [distance, np.ptp(origins, axis=0).max()]  # parallel axes meet nowhere: the cameras' own extent
    if xyz is not None and len(xyz):
        reach.append(float(np.median(np.linalg.norm(xyz - origins.mean(0), axis=1))))
    if np.abs(centre).max() <= FAR * max(reach):
        return np.zeros(3)
    grid = 2.0 ** math.floor(math.log2(distance))
    return np.asarray(np.round(centre / grid) * grid)


def working_box(viewmats: np.ndarray, Ks: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, float]:
    """Centre [3] and half side (scene units) of the cube that cameras with pictures of size (W, H) look at together.

    The centre is the point nearest to all optical axes (least squares); the half side is what the widest camera
    sees at that distance.
    """
    origins, axes = optical_axes(viewmats)
    middle = origins.mean(0)
    A, b = nearest_point_equations(origins - middle, axes)
    # a small pull to a point in front of the mean camera settles parallel axes
    depth = np.median(np.linalg.norm(origins - middle, axis=1))
    if depth <= 1e-12 * np.abs(origins).max():
        depth = 1.0  # cameras at one place see no distance: one scene unit
    centre = middle + np.linalg.solve(A + 1e-3 * np.eye(3), b + 1e-3 * depth * axes.mean(0))
    distance = np.linalg.norm(origins - centre, axis=1)
    half_field = np.maximum(size[0] / Ks[:, 0, 0], size[1] / Ks[:, 1, 1]) / 2
    return centre, float(np.max(distance * half_field))


def middle_distance(
    viewmats: np.ndarray, Ks: np.ndarray, size: tuple[int, int], xyz: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Return the point [3] that the cameras look at, and its median distance from them in scene units.

    Cameras at one place see no distance: of these, the middle of the points xyz [M, 3] and their distance, if given.
    """
    origins, _ = optical_axes(viewmats)
    if xyz is not None and np.ptp(origins, axis=0).max() <= 1e-12 * np.abs(origins).max():
        centre = np.median(xyz.astype(np.float64), axis=0)
    else:
        centre, _ = working_box(viewmats, Ks, size)
    return centre, float(np.median(np.linalg.norm(origins - centre, axis=1))) or 1.0
