"""One camera: pose, field of view, principal point; equal by value, so that equal pictures are shared."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import GenerateError

CAMERA_ANGLE_X = 0.6911112070083618  # NeRF-synthetic's horizontal field of view, radians
DISTANCE = float(np.hypot(4.0, 0.5))  # of the original cameras from the origin, 4.0311 scene units
_NARROWEST, _WIDEST = math.radians(0.1), math.radians(170.0)
_PARALLEL = 1e-9  # of sines: a line of sight this near to vertical has no upright picture


@dataclass(frozen=True, eq=False)
class SceneCamera:
    """One view: its number in the file names, its pose and lens. Square pixels, no distortion.

    Two cameras are equal, and hash alike, if all of their numbers are. The pose is kept as a read-only copy.
    Raises GenerateError for a pose that is not rigid or a field of view outside 0.1° … 170°.
    """

    index: int
    camera_to_world: np.ndarray  # [4, 4] float64, OpenGL axes (x right, y up, looks along −z)
    rotation: float = 0.0  # radians; of the original files: half of the azimuth step, 0 off the spiral
    angle_x: float = CAMERA_ANGLE_X  # horizontal field of view, radians
    shift: tuple[float, float] = (0.0, 0.0)  # principal point off the centre, x right, y down, image widths

    def __post_init__(self) -> None:
        pose = np.array(self.camera_to_world, np.float64) + 0.0  # −0.0 becomes 0.0: equal values, equal bytes
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise GenerateError(f"camera {self.index}: its pose is not a finite 4×4 matrix: {pose.tolist()}")
        off = float(np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max())
        if off > 1e-5 or np.linalg.det(pose[:3, :3]) < 0 or pose[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
            raise GenerateError(f"camera {self.index}: its pose is not rigid, off by {off:.3g}")
        if not _NARROWEST <= self.angle_x <= _WIDEST:
            raise GenerateError(
                f"camera {self.index}: its field of view {math.degrees(self.angle_x):g}° is not in 0.1° … 170°"
            )
        if len(self.shift) != 2 or not np.isfinite(self.shift).all():
            raise GenerateError(
                f"camera {self.index}: its principal-point offset is {self.shift!r}, expected two finite numbers"
            )
        pose.setflags(write=False)
        object.__setattr__(self, "camera_to_world", pose)
        object.__setattr__(self, "shift", (float(self.shift[0]) + 0.0, float(self.shift[1]) + 0.0))

    @property
    def name(self) -> str:
        return f"r_{self.index:03d}"

    @property
    def position(self) -> np.ndarray:
        """Return [3] float64, scene units."""
        return self.camera_to_world[:3, 3]

    def focal(self, width: int) -> float:
        """Focal length in pixels of a picture of this width; the same along y."""
        return focal_length(width, self.angle_x)

    def principal_point(self, width: int, height: int) -> tuple[float, float]:
        """Return (cx, cy) in pixels; the centre of pixel (column i, row j) lies at (i + 0.5, j + 0.5)."""
        return width * (0.5 + self.shift[0]), 0.5 * height + width * self.shift[1]

    def project(self, positions: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates [P, 2] and planar depth [P] of world points [P, 3]; depth ≤ 0 is behind it."""
        focal = self.focal(width)
        return project(positions, self.camera_to_world, (focal, focal, *self.principal_point(width, height)))

    def numbered(self, index: int) -> "SceneCamera":
        """The same camera under another number."""
        return replace(self, index=index)

    def _key(self) -> tuple[Any, ...]:
        return self.index, self.camera_to_world.tobytes(), self.rotation, self.angle_x, self.shift

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, SceneCamera) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def to_json(self) -> dict[str, Any]:
        """Plain data; `from_json` gives an equal camera."""
        return {
            "index": self.index, "camera_to_world": self.camera_to_world.tolist(), "rotation": self.rotation,
            "angle_x": self.angle_x, "shift": list(self.shift),
        }  # fmt: skip

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "SceneCamera":
        pose, (x, y) = np.array(data["camera_to_world"], np.float64), data["shift"]
        return cls(data["index"], pose, data["rotation"], data["angle_x"], (x, y))


@dataclass(frozen=True)
class Aim:
    """The target of a camera path, its distance, and the lens."""

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # looked at, scene units
    distance: float = DISTANCE  # from the centre, scene units
    angle_x: float = CAMERA_ANGLE_X  # horizontal field of view, radians

    def place(self, azimuth: float, elevation: float, nearness: float = 1.0) -> np.ndarray:
        """Return [3] float64: `nearness` · distance from the centre, towards an azimuth and an elevation (radians)."""
        return np.array(self.centre) + self.distance * nearness * direction(azimuth, elevation)

    def look_from(self, index: int, position: np.ndarray, rotation: float = 0.0) -> SceneCamera:
        """A camera at `position` [3] that looks at the centre."""
        return SceneCamera(index, look_at(position, np.array(self.centre)), rotation, self.angle_x)


ORIGINAL = Aim()


def focal_length(width: int, angle_x: float = CAMERA_ANGLE_X) -> float:
    """Focal length in pixels; `angle_x`: horizontal field of view, radians."""
    return 0.5 * width / float(np.tan(0.5 * angle_x))


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Camera-to-world [4, 4] of a camera at `position` that looks at `target`, world z up in the image.

    Looking straight up or down, y is up. Raises GenerateError if the two are the same point.
    """
    back = np.asarray(position, np.float64) - np.asarray(target, np.float64)
    distance = float(np.linalg.norm(back))
    if not distance > 0:
        raise GenerateError(f"a camera at {np.asarray(position).tolist()} cannot look at its own position")
    back = back / distance
    right = np.cross([0.0, 0.0, 1.0], back)
    if np.linalg.norm(right) < _PARALLEL:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(back, right), back])
    pose[:3, 3] = position
    return pose


def look_at_origin(position: np.ndarray) -> np.ndarray:
    """Camera-to-world [4, 4] of a camera at `position` that looks at the origin, world z up in the image."""
    return look_at(position, np.zeros(3))


def direction(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector [3] towards an azimuth (from x to y) and an elevation, radians."""
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


def scene_cameras(
    poses: Sequence[np.ndarray],
    angles_x: Sequence[float],
    shifts: Sequence[tuple[float, float]] | None = None,
) -> tuple[SceneCamera, ...]:
    """Cameras found in a user's scene, numbered in order.

    Parameters: `poses`, camera-to-world [4, 4] with OpenGL axes, as Blender's matrix_world is; a scale in
    them, which moves no ray, is taken out; `angles_x`, horizontal fields of view, radians; `shifts`,
    principal points off the centre, x right, y down, in image widths (Blender's shift_x negated, and shift_y
    as it is, where the sensor's width is that of the image). Raises GenerateError for a flattened pose.
    """
    shifts = [(0.0, 0.0)] * len(poses) if shifts is None else shifts
    return tuple(
        SceneCamera(i, _rigid(i, np.array(pose, np.float64)), 0.0, float(angle), shift)
        for i, (pose, angle, shift) in enumerate(zip(poses, angles_x, shifts, strict=True))
    )


def _rigid(index: int, pose: np.ndarray) -> np.ndarray:
    """The pose with unit axes: its line of sight and its upright kept, x made to fit."""
    up, back = pose[:3, 1], pose[:3, 2]
    right = np.cross(up, back)
    with np.errstate(invalid="ignore"):
        flat = np.linalg.norm(right) / (np.linalg.norm(up) * np.linalg.norm(back) or 1.0)
    if not flat > 1e-6:
        raise GenerateError(f"camera {index}: its pose is flattened: {pose[:3, :3].tolist()}")
    right, back = right / np.linalg.norm(right), back / np.linalg.norm(back)
    rigid = np.eye(4)
    rigid[:3, :3] = np.column_stack([right, np.cross(back, right), back])
    rigid[:3, 3] = pose[:3, 3]
    return rigid


def transforms(
    cameras: Sequence[SceneCamera],
    split: str,
    time_s: float,
    width: int,
    height: int,
    suffix: str = "",
    at_rest: Collection[SceneCamera] = (),
) -> dict[str, object]:
    """Content of `transforms_<split>.json`: NeRF-synthetic's keys, time in seconds, intrinsics as extras.

    Every frame has fl_x, fl_y, cx, cy, w, h (pixels); those on which all frames agree stand at the top
    too. camera_angle_x, which plain loaders go by, is that of the first camera: with lenses that differ, only a
    loader of the frames' own values is right. `suffix`: of the image files where it is not ".png". `at_rest`: cameras
    whose pictures show the scene before it moves, and have no time.
    """
    if not cameras:
        raise ValueError(f"no cameras for transforms_{split}.json")
    frames = [
        _frame(camera, split, None if camera in at_rest else time_s, width, height, suffix)
        for camera in cameras
    ]
    shared = {
        key: frames[0][key]
        for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")
        if all(frame[key] == frames[0][key] for frame in frames)
    }
    return {"camera_angle_x": cameras[0].angle_x, **shared, "frames": frames}


def _frame(
    camera: SceneCamera, split: str, time_s: float | None, width: int, height: int, suffix: str
) -> dict[str, Any]:
    focal, (cx, cy) = camera.focal(width), camera.principal_point(width, height)
    return {
        "file_path": f"./{split}/{camera.name}{'' if suffix == '.png' else suffix}",
        "rotation": camera.rotation, **({} if time_s is None else {"time": time_s}),
        "transform_matrix": camera.camera_to_world.tolist(), "fl_x": focal, "fl_y": focal, "cx": cx, "cy": cy,
        "w": width, "h": height,
    }  # fmt: skip


Intrinsics = tuple[float, float, float, float]  # fx, fy, cx, cy, pixels


def project(
    points: np.ndarray, camera_to_world: np.ndarray, intrinsics: Intrinsics
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [..., 2] and planar depth [...] of world points [..., 3]; depth ≤ 0 is behind the camera.

    Pose with OpenGL axes; the centre of pixel (column i, row j) lies at (i + 0.5, j + 0.5).
    """
    local = (points - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    depth = -local[..., 2]
    fx, fy, cx, cy = intrinsics
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.stack([fx * local[..., 0] / depth + cx, cy - fy * local[..., 1] / depth], -1)
    return pixels, depth
