"""The first view after an import: frames the objects in the 3D views and prepares the panel's spectrum."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from mathutils import Matrix, Vector

from .. import names
from ..nodes import changes, drawing, scene
from . import analysis, pictures

_SOLID = ("MESH", "CURVE", "SURFACE", "META", "FONT")  # what may hide something
ROOM = 1.2  # of the size, around it
_STARTUP_CAMERA = (7.358891, -6.925791, 4.958309)  # where it stands in Blender's own startup scene


def show(context: Any, objects: Sequence[Any]) -> list[str]:
    """Frame the objects in every 3D view of the window, unless it looks through a camera; draw the spectrum.

    The startup scene's camera, where it still stands as it did, frames them, too, and its cube is hidden where it is in
    the way. Returns messages.
    """
    context.view_layer.update()  # where the objects are
    low, high = box(objects)
    notes = _uncover(context, objects, low, high)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    _aim(context.scene, middle, radius)
    window = context.window
    for number, area in enumerate(() if window is None else window.screen.areas):
        if area.type == "VIEW_3D":
            if area.spaces.active.shading.type in ("SOLID", "WIREFRAME"):
                changes.put(window.screen, {f"areas[{number}].spaces[0].shading.type": "MATERIAL"})
            _frame(area, middle, radius)
    if scene.moves(objects[0]):
        pictures.prepare(*analysis.spectrum_picture(context, objects[0]))
    return notes


def box(objects: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner [3] of the objects' opaque Gaussians, in world space."""
    ends = []
    for obj in objects:
        points = drawing.main_points(scene.first_mesh(obj))  # all where none is opaque
        if len(points):
            turned = points @ np.array(obj.matrix_world)[:3, :3].T + np.array(obj.matrix_world)[:3, 3]
            ends.append(np.percentile(turned, drawing.ENDS, axis=0))
    if not ends:
        return -np.ones(3), np.ones(3)
    return np.min([e[0] for e in ends], axis=0), np.max([e[1] for e in ends], axis=0)


def _aim(scene: Any, middle: np.ndarray, radius: float) -> None:
    """Move the untouched startup camera, in its direction, so that the sphere fills its picture."""
    camera = scene.camera
    if (
        camera is None
        or camera.type != "CAMERA"
        or camera.animation_data
        or camera.parent
        or camera.constraints
    ):
        return
    if max(abs(a - b) for a, b in zip(camera.location, _STARTUP_CAMERA, strict=True)) > 1e-3:
        return
    corners = np.array([tuple(corner) for corner in camera.data.view_frame(scene=scene)])
    half = math.atan(np.abs(corners[:, :2]).max(axis=0).min() / -corners[0, 2])
    distance = ROOM * radius / math.sin(half)
    wanted = {
        "location": (middle + distance * np.array(camera.matrix_world.col[2][:3])).tolist(),
        "data.clip_start": min(camera.data.clip_start, distance / 100),
        "data.clip_end": max(camera.data.clip_end, 10 * distance),
    }
    changes.put(camera, wanted)


def _uncover(context: Any, objects: Sequence[Any], low: np.ndarray, high: np.ndarray) -> list[str]:
    notes = []
    for other in context.view_layer.objects:
        if other in objects or other.type not in _SOLID or not other.visible_get() or names.MARK in other:
            continue
        corners = np.array([other.matrix_world @ Vector(corner) for corner in other.bound_box])
        least, largest = corners.min(axis=0), corners.max(axis=0)
        if _is_startup_cube(other) and (least < high).all() and (largest > low).all():
            other.hide_render = True
            other.hide_set(True)
            notes.append(f"Hid the start-up {other.name}, in the way")
        elif other.display_type not in ("WIRE", "BOUNDS") and (least < low).all() and (largest > high).all():
            notes.append(f"The splats are inside {other.name}")
    return notes


def _is_startup_cube(obj: Any) -> bool:
    if (
        obj.type != "MESH"
        or not obj.name.startswith("Cube")
        or obj.modifiers
        or obj.animation_data
        or obj.parent
    ):
        return False
    if obj.matrix_world != Matrix.Identity(4) or (len(obj.data.vertices), len(obj.data.polygons)) != (8, 6):
        return False
    return all(abs(abs(c) - 1.0) < 1e-6 for vertex in obj.data.vertices for c in vertex.co)


def _frame(area: Any, middle: np.ndarray, radius: float) -> None:
    space = area.spaces.active
    view = space.region_3d
    if view is None or view.view_perspective == "CAMERA":
        return
    region = next(r for r in area.regions if r.type == "WINDOW")
    width, height = max(region.width, 1), max(region.height, 1)
    # The lens is that of a 72 mm wide picture along the view's longer side.
    half = math.atan(36.0 / space.lens * min(width, height) / max(width, height))
    view.view_location = middle.tolist()
    view.view_distance = ROOM * radius / math.sin(half)
    space.clip_start = min(space.clip_start, view.view_distance / 100)
    space.clip_end = max(space.clip_end, 10 * view.view_distance)
