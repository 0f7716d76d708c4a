"""Cameras for rendering: those of a capture, an orbit around its subject, or a transforms JSON file."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.cameras import (
    nearest_point_equations,
    optical_axes,
    read_intrinsics,
    read_pose,
    world_to_camera,
)
from tg4mm.capture.frames import image_path
from tg4mm.capture.model import Capture
from tg4mm.core.errors import CaptureError, RunError
from tg4mm.core.pictures.decode import image_header
from tg4mm.core.untrusted import JsonRecord, read_record
from tg4mm.core.values import shown
from tg4mm.fit.motion.observations import PosedFrames

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_LARGEST = 16_384  # pixels a side
_LEFT_OUT = math.radians(150)  # a wider gap between neighbouring cameras is not part of an orbit
_LEAST_SIDE = math.radians(10)  # to either side, for an orbit to and fro


@dataclass(frozen=True)
class Camera:
    """One pinhole camera. Conventions: docs/conventions.md."""

    name: str  # file stem of its pictures, for example r_000
    viewmat: np.ndarray  # [4, 4] float64, world-to-camera, OpenCV axes
    K: np.ndarray  # [3, 3] float64, pixels, pixel centres at +0.5
    width: int  # pixels
    height: int  # pixels

    @staticmethod
    def of(frames: PosedFrames, size: tuple[int, int]) -> "Camera":
        """Return the camera of some frames of `size` (w, h)."""
        return Camera(frames.name, frames.viewmat.astype(float), frames.K.astype(float), *size)

    @property
    def view(self) -> tuple[np.ndarray, np.ndarray, int, int]:
        """`viewmat`, `K`, `width` and `height`."""
        return self.viewmat, self.K, self.width, self.height

    @property
    def position(self) -> np.ndarray:
        """Position [3], scene units."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Unit vector [3] of the viewing direction, world axes."""
        return self.viewmat[2, :3]

    def cut(self, corners: np.ndarray, around: float) -> "Camera":
        """Return a camera of pixels [P, 2] and `around` × their extent on every side; the size is even."""
        low, high = corners.min(0), corners.max(0)
        wide = around * (high - low)
        first = np.clip(np.floor(low - wide), 0, [self.width - 2, self.height - 2]).astype(int)
        last = np.clip(np.ceil(high + wide), first + 2, [self.width, self.height]).astype(int)
        width, height = (last - first) // 2 * 2
        K = self.K.copy()
        K[:2, 2] -= first
        return Camera(self.name, self.viewmat, K, int(width), int(height))


def capture_cameras(capture: Capture) -> tuple[Camera, ...]:
    """Return the different cameras of a capture.

    Args:
        capture: of any kind; a moving camera gives one camera for each pose.

    Returns:
        Cameras in order of first appearance, each named after its first picture.
    """
    cameras, names = [], set()
    for camera_id in dict.fromkeys(capture.camera_ids.tolist()):
        i = int(np.flatnonzero(capture.camera_ids == camera_id)[0])
        name = capture.paths[i].stem
        if name in names:  # a moving camera gives several poses one file name
            name = f"{name}_{camera_id:03d}"
        names.add(name)
        cameras.append(Camera(name, capture.viewmats[i], capture.Ks[i], capture.width, capture.height))
    return tuple(cameras)


def capture_path(capture: Capture) -> tuple[Camera, ...]:
    """Return the moving or fixed camera at every timestep, named r_000, r_001 … by timestep.

    Raises CaptureError for one timestep, and if a timestep has pictures from several poses or from none.
    """
    if capture.n_timesteps < 2:
        raise CaptureError(f"{capture.root}: has one timestep: there is no camera path to follow")
    cameras = []
    for t in range(capture.n_timesteps):
        rows = np.flatnonzero((capture.timesteps == t) & np.isfinite(capture.times_s))
        poses = set(capture.camera_ids[rows].tolist())
        if len(poses) != 1:
            what = "no picture" if not poses else f"pictures from {len(poses)} poses"
            raise CaptureError(
                f"{capture.root}: timestep {t} has {what}: --path capture needs one camera; choose --split or --orbit"
            )
        i = int(rows[0])
        name = f"r_{t:03d}"
        cameras.append(Camera(name, capture.viewmats[i], capture.Ks[i], capture.width, capture.height))
    return tuple(cameras)


def look_at_point(viewmats: np.ndarray) -> np.ndarray:
    """Return the point [3] nearest to all optical axes in the least-squares sense; viewmats are [C, 4, 4].

    Raises RunError if the axes (nearly) coincide or are parallel, or if most cameras look away from it.
    """
    positions, forward = optical_axes(viewmats)
    normal, right = nearest_point_equations(positions, forward)
    if np.linalg.cond(normal) > 1e6:
        raise RunError(
            f"the {len(viewmats)} cameras look in one direction, so there is no point to orbit around"
        )
    point = np.linalg.solve(normal, right)
    ahead = np.einsum("ci,ci->c", point - positions, forward)
    if np.mean(ahead > 0) <= 0.5:
        raise RunError(
            f"only {np.mean(ahead > 0):.0%} of the cameras look inwards: there is no point to orbit around"
        )
    return point


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return world-to-camera [4, 4], OpenCV axes, of a camera at `position` that looks at `target` with +Z up."""
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross(z, [0.0, 0.0, 1.0])
    # Straight down or up there is no horizon; any direction across will do.
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < 1e-9 else x / np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ position
    return viewmat


def orbit(capture: Capture, n: int, centre: np.ndarray | None = None) -> tuple[Camera, ...]:
    """Return cameras on a level circle around the scene, beginning at the azimuth of the capture's first camera.

    They go once around, evenly spaced; if the capture's cameras leave a gap of 150 degrees, they go to and fro over
    the covered part (at least ten degrees to either side), since the scene's back is unknown. Radius, elevation and
    focal length are the medians of the capture's cameras.

    Args:
        capture: the cameras to follow.
        n: number of cameras, at least 1.
        centre: [3] scene units, used if the capture's cameras look at no common point (a single fixed camera).

    Returns:
        `n` cameras.

    Raises:
        RunError: `n` is below 1, or there is neither a common point nor a `centre`.
    """
    if n < 1:
        raise RunError(f"--orbit {n}: needs at least one frame")
    try:
        target = look_at_point(capture.viewmats)
    except RunError:
        if centre is None:
            raise
        target = np.asarray(centre, dtype=float)
    arms = optical_axes(capture.viewmats)[0] - target
    distances = np.linalg.norm(arms, axis=1)
    radius = float(np.median(distances))
    elevation = float(np.median(np.arcsin(np.clip(arms[:, 2] / distances, -1.0, 1.0))))
    elevation = float(np.clip(elevation, math.radians(-85), math.radians(85)))
    azimuths = _azimuths(np.arctan2(arms[:, 1], arms[:, 0]), n)
    focal = float(np.median(capture.Ks[:, 0, 0]))
    K = np.array([[focal, 0, capture.width / 2], [0, focal, capture.height / 2], [0, 0, 1.0]])
    cameras = []
    for i, azimuth in enumerate(azimuths):
        level = np.array([math.cos(azimuth), math.sin(azimuth)]) * math.cos(elevation)
        position = target + radius * np.array([*level, math.sin(elevation)])
        cameras.append(Camera(f"r_{i:03d}", look_at(position, target), K, capture.width, capture.height))
    return tuple(cameras)


def _azimuths(of_capture: np.ndarray, n: int) -> np.ndarray:
    """Return the azimuths [n] of an orbit, radians, from those of a capture's cameras [V]."""
    ahead = np.arange(n) / n * 2 * math.pi
    around = np.sort(np.mod(of_capture, 2 * math.pi))
    gaps = np.diff(around, append=around[0] + 2 * math.pi)
    widest = int(gaps.argmax())
    if gaps[widest] < _LEFT_OUT:
        return np.asarray(of_capture[0] + ahead)
    span = 2 * math.pi - gaps[widest]
    middle = around[(widest + 1) % len(around)] + span / 2
    side = max(span / 2, _LEAST_SIDE)
    first = math.remainder(of_capture[0] - middle, 2 * math.pi)
    return np.asarray(middle + side * np.sin(math.asin(np.clip(first / side, -1, 1)) + ahead))


def cameras_from_file(path: Path, size: tuple[int, int] | None = None) -> tuple[Camera, ...]:
    """Read the cameras of a NeRF-synthetic or nerfstudio transforms JSON, in the file's order, without its images.

    `size` (width, height) in pixels replaces missing `w` and `h`. Raises CaptureError for a damaged file.
    """
    file = read_record(Path(path))
    frames = file.values.get("frames")
    if not isinstance(frames, list) or not frames:
        raise file.error("frames", "a list of at least one frame")
    cameras = [_camera_of_frame(file, i, frame, size) for i, frame in enumerate(frames)]
    names = [camera.name for camera in cameras]
    if len(set(names)) < len(names):  # several folders with equal file names: number them
        cameras = [Camera(f"r_{i:03d}", c.viewmat, c.K, c.width, c.height) for i, c in enumerate(cameras)]
    return tuple(cameras)


def size_of_first_picture(path: Path) -> tuple[int, int] | None:
    """Return (width, height) of the first frame's picture in a transforms JSON; None if it does not exist."""
    frames = read_record(Path(path)).values.get("frames")
    first = frames[0] if isinstance(frames, list) and frames and isinstance(frames[0], dict) else {}
    name, folder = first.get("file_path"), Path(path).parent
    if not isinstance(name, str):
        return None
    try:
        header = image_header(image_path(folder, folder, name, str(path)))
    except CaptureError:
        return None
    return header.width, header.height


def _camera_of_frame(file: JsonRecord, i: int, values: Any, size: tuple[int, int] | None) -> Camera:
    where = f"{file.where}: frames[{i}]"
    if not isinstance(values, dict):
        raise CaptureError(f"{where}: is {shown(values)}; expected a JSON object")
    frame = JsonRecord(where, values)
    width, height = (_pixels(frame, file, key, size and size[k]) for k, key in enumerate("wh"))
    K = read_intrinsics(frame, file, width, height)
    name = Path(frame.text("file_path")).stem if frame.has("file_path") else f"r_{i:03d}"
    return Camera(name, world_to_camera(read_pose(frame)), K, width, height)


def _pixels(frame: JsonRecord, file: JsonRecord, key: str, default: int | None) -> int:
    record = frame if frame.has(key) else file
    if default is not None and not record.has(key):
        return default
    value = record.whole(key, 1)
    if value > _LARGEST:
        raise record.error(key, f"a whole number of at most {_LARGEST}")
    return value


def transforms_json(cameras: tuple[Camera, ...]) -> dict[str, Any]:
    """Return the cameras as a nerfstudio-style dictionary, which `cameras_from_file` reads."""
    frames = []
    for camera in cameras:
        c2w = np.linalg.inv(camera.viewmat) @ _OPENGL_FROM_OPENCV
        frames.append(
            {
                "file_path": camera.name,
                "transform_matrix": c2w.tolist(),
                "w": camera.width,
                "h": camera.height,
                "fl_x": float(camera.K[0, 0]),
                "fl_y": float(camera.K[1, 1]),
                "cx": float(camera.K[0, 2]),
                "cy": float(camera.K[1, 2]),
            }
        )
    return {"camera_model": "OPENCV", "frames": frames}
