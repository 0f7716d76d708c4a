"""Where pictures are taken from: orbit, rig, sweep, handheld and given cameras, and their JSON. Pure numpy.

A camera-to-world matrix has OpenGL axes (x right, y up, looks along −z), as in NeRF-synthetic.
"""

from __future__ import annotations

from .camera import (
    CAMERA_ANGLE_X,
    DISTANCE,
    Aim,
    Camera,
    focal_length,
    look_at,
    look_at_origin,
    scene_cameras,
)
from .orbit import spiral, test_cameras, train_cameras
from .setup import KINDS, CameraSetup, cameras_at
from .transforms import transforms

__all__ = [
    "CAMERA_ANGLE_X",
    "DISTANCE",
    "KINDS",
    "Aim",
    "Camera",
    "CameraSetup",
    "cameras_at",
    "focal_length",
    "look_at",
    "look_at_origin",
    "scene_cameras",
    "spiral",
    "test_cameras",
    "train_cameras",
    "transforms",
]
