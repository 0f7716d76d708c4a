"""From the panel's settings to a motion description, and to the motion of bodies; checked as the generator does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from dataset_gen.cameras import CameraSetup, cameras_at, scene_cameras
from dataset_gen.cameras.camera import Camera
from dataset_gen.errors import GenerateError
from dataset_gen.vibration import (
    Body,
    Motion,
    MotionDescription,
    pixel_displacement,
    read_motion,
    solve,
)

from . import kinds


def description(settings: Any, parts: Sequence[str]) -> MotionDescription:
    """What the settings describe. Raises GenerateError, one line."""
    if settings.source == "FILE":
        if not settings.motion_file:
            raise GenerateError("Description is empty: choose a motion description, or One Mode")
        return read_motion(Path(bpy.path.abspath(settings.motion_file)))
    return MotionDescription.from_json({"modes": [kinds.mode(settings, list(parts))]}, "panel")


def motion(settings: Any, described: MotionDescription, bodies: Sequence[Body], scene: Any) -> Motion:
    """The motion of the bodies, as the generator solves it. Raises GenerateError."""
    camera = None
    if any(mode.amplitude_px for mode in described.modes):
        camera = reference_camera(settings, bodies, scene)

    def pixels(positions: np.ndarray, shape: np.ndarray) -> float:
        assert camera is not None
        focal = camera.focal(settings.size)
        return pixel_displacement(positions, shape, camera.camera_to_world, focal, focal)

    return solve(described, bodies, settings.fps, pixels if camera is not None else None, settings.seed)


def reference_camera(settings: Any, bodies: Sequence[Body], scene: Any) -> Camera:
    """Training camera 0, that amplitudes in pixels are meant for. Raises GenerateError.

    The generator leaves floors and skies out of what it looks at; here every body counts, so with a wide floor
    the preview of an amplitude in pixels is larger than the data's.
    """
    points = np.concatenate([body.vertices for body in bodies]) if bodies else np.zeros((1, 3))
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    found: tuple[Camera, ...] = ()
    if settings.cameras == "given" and scene.camera is not None and scene.camera.data.type == "PERSP":
        corners = np.array([tuple(corner) for corner in scene.camera.data.view_frame(scene=scene)])
        width = float(np.ptp(corners[:, 0]))
        angle = 2.0 * math.atan(0.5 * width / -corners[0, 2])
        found = scene_cameras([np.array(scene.camera.matrix_world)], [angle], [(0.0, 0.0)])
    setup = CameraSetup(
        kind=settings.cameras, views=settings.views, test_views=0, n_timesteps=settings.timesteps,
        fps=settings.fps, seed=settings.seed,
    )  # fmt: skip
    return cameras_at(setup.placed(centre.tolist(), radius, found).framing(points), 0)["train"][0]
