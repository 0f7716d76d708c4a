"""Cameras of the NeRF-synthetic spiral: camera-to-world matrices with OpenGL axes, and their JSON.

The formula is that of the script which rendered NeRF-synthetic: a camera at (0, 4, 0.5) looks at the origin
and hangs on an empty that is turned about z by twice the step of its tilt about x. The empty's angles are
float32 in Blender and sums of steps drift by 1e-6; the drift is reproduced, so poses agree with [3DMM]'s
files to 1e-6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CAMERA_ANGLE_X = 0.6911112070083618  # horizontal field of view, radians
_DISTANCE = float(np.hypot(4.0, 0.5))  # 4.0311 scene units from the origin
_BASE_ELEVATION = float(np.arctan2(0.5, 4.0))
_TEST_PATH = 10  # views of the published test path; fewer are chosen from it


@dataclass(frozen=True)
class Camera:
    """One view: its number in the file names, its pose, and the `rotation` field of the original files."""

    index: int
    camera_to_world: np.ndarray  # [4, 4] float64, OpenGL axes (x right, y up, looks along −z)
    rotation: float  # radians; half of the azimuth step, as the original writes it

    @property
    def name(self) -> str:
        return f"r_{self.index:03d}"


def look_at_origin(position: np.ndarray) -> np.ndarray:
    """Camera-to-world [4, 4] of a camera at `position` that looks at the origin, world z up in the image."""
    back = position / np.linalg.norm(position)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(back, right), back])
    pose[:3, 3] = position
    return pose


def spiral(n_views: int, tilt: float, start: float) -> list[Camera]:
    """Two turns of azimuth from 90° + `start`, elevation 7.1° + (0 … `tilt`); angles in radians."""
    step = 2.0 * np.pi / n_views
    azimuth = np.float32(start)
    cameras = []
    for i in range(n_views):
        if i:
            azimuth = np.float32(azimuth + 2.0 * step)
        # View 0 has the start tilt; from then on the tilt lags one step behind, as in the original.
        raised = tilt if i == 0 else tilt * (1.0 + np.cos(step * (i - 1))) / 2.0
        elevation = _BASE_ELEVATION + float(np.float32(raised))
        angle = float(azimuth) + np.pi / 2.0
        direction = np.array(
            [np.cos(elevation) * np.cos(angle), np.cos(elevation) * np.sin(angle), np.sin(elevation)]
        )
        cameras.append(Camera(i, look_at_origin(_DISTANCE * direction), step))
    return cameras


def train_cameras(n_views: int) -> list[Camera]:
    """Training views; 30 of them are exactly those of the published data."""
    return spiral(n_views, 0.7, 0.0)


def test_cameras(n_views: int) -> list[Camera]:
    """Test views: spread over the published path of 10, numbered as in it; above 10 a path of their own."""
    if n_views > _TEST_PATH:
        return spiral(n_views, 0.6, np.radians(15.0))
    path = spiral(_TEST_PATH, 0.6, np.radians(15.0))
    return [path[i * _TEST_PATH // n_views] for i in range(n_views)]


def focal_length(width: int) -> float:
    """Focal length in pixels."""
    return 0.5 * width / float(np.tan(0.5 * CAMERA_ANGLE_X))


def transforms(
    cameras: list[Camera], split: str, time_s: float, width: int, height: int
) -> dict[str, object]:
    """Content of `transforms_<split>.json`: NeRF-synthetic's keys, time in seconds, intrinsics as extras."""
    focal = focal_length(width)
    return {
        "camera_angle_x": CAMERA_ANGLE_X,
        "fl_x": focal,
        "fl_y": focal,
        "cx": width / 2.0,
        "cy": height / 2.0,
        "w": width,
        "h": height,
        "frames": [
            {
                "file_path": f"./{split}/{camera.name}",
                "rotation": camera.rotation,
                "time": time_s,
                "transform_matrix": camera.camera_to_world.tolist(),
            }
            for camera in cameras
        ],
    }
