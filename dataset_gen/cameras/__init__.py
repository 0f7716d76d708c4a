"""Camera positions and times: orbit, rig, sweep, handheld, clips, flat and given cameras. Pure numpy.

A camera-to-world matrix has OpenGL axes (x right, y up, looks along −z), as in NeRF-synthetic.
"""

from .camera import (
    CAMERA_ANGLE_X,
    DISTANCE,
    Aim,
    SceneCamera,
    focal_length,
    look_at,
    look_at_origin,
    scene_cameras,
    transforms,
)
from .paths import spiral, test_cameras, train_cameras
from .setup import KINDS, CameraSetup, cameras_at, clock_offsets, films, scene_time

__all__ = [
    "CAMERA_ANGLE_X",
    "DISTANCE",
    "KINDS",
    "Aim",
    "CameraSetup",
    "SceneCamera",
    "cameras_at",
    "clock_offsets",
    "films",
    "focal_length",
    "look_at",
    "look_at_origin",
    "scene_cameras",
    "scene_time",
    "spiral",
    "test_cameras",
    "train_cameras",
    "transforms",
]  # fmt: skip
