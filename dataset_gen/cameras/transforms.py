"""Cameras as NeRF-synthetic's JSON, with the intrinsics of every frame beside them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from .camera import Camera


def transforms(
    cameras: Sequence[Camera],
    split: str,
    time_s: float,
    width: int,
    height: int,
    suffix: str = "",
    at_rest: Collection[Camera] = (),
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
    camera: Camera, split: str, time_s: float | None, width: int, height: int, suffix: str
) -> dict[str, Any]:
    focal, (cx, cy) = camera.focal(width), camera.principal_point(width, height)
    return {
        "file_path": f"./{split}/{camera.name}{'' if suffix == '.png' else suffix}",
        "rotation": camera.rotation,
        **({} if time_s is None else {"time": time_s}),
        "transform_matrix": camera.camera_to_world.tolist(),
        "fl_x": focal,
        "fl_y": focal,
        "cx": cx,
        "cy": cy,
        "w": width,
        "h": height,
    }
