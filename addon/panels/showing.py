"""What an import shows at once: objects framed in the 3D views, in their colours, and the panel's spectrum drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import names
from ..nodes import scene
from . import panel, pictures

OPAQUE = 0.3  # what is fainter may lie far off and counts for no size
ENDS = (1.0, 99.0)  # percentiles along each axis that are framed
ROOM = 1.2  # of the size, around it


def show(context: Any, objects: Sequence[Any]) -> None:
    """Frame the objects in every 3D view of the window, unless it looks through a camera; draw the spectrum."""
    middle, radius = extent(objects)
    window = context.window
    for area in () if window is None else window.screen.areas:
        if area.type == "VIEW_3D":
            _frame(area, middle, radius)
    if scene.moves(objects[0]):
        pictures.prepare(*panel.spectrum_picture(context, objects[0]))


def extent(objects: Sequence[Any]) -> tuple[np.ndarray, float]:
    """Middle [3] and radius, scene units, of what is opaque of the objects."""
    ends = []
    for obj in objects:
        points = _points(obj)
        if len(points):
            turned = points @ np.array(obj.matrix_world)[:3, :3].T + np.array(obj.matrix_world)[:3, 3]
            ends.append(np.percentile(turned, ENDS, axis=0))
    if not ends:
        return np.zeros(3), 1.0
    low, high = np.min([e[0] for e in ends], axis=0), np.max([e[1] for e in ends], axis=0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)


def _points(obj: Any) -> np.ndarray:
    """[n, 3] positions of the opaque Gaussians, of a sequence those of its first frame; all where none is opaque."""
    frames = scene.sequence_frames(obj)
    mesh = obj.data if frames is None else frames[0].data
    places = np.empty(3 * len(mesh.vertices), np.float32)
    opacities = np.empty(len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", places)
    mesh.attributes[names.OPACITY].data.foreach_get("value", opacities)
    solid = opacities >= OPAQUE
    return places.reshape(-1, 3)[solid if solid.any() else slice(None)].astype(np.float64)


def _frame(area: Any, middle: np.ndarray, radius: float) -> None:
    space = area.spaces.active
    if space.shading.type in ("SOLID", "WIREFRAME"):
        space.shading.type = "MATERIAL"
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
