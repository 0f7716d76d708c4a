"""The scene's objects as the generator will see them: what moves, its parts' names, its vertices at rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from .. import names
from ..generator.dataset_gen.vibration import Body

_GLOB = str.maketrans({"[": "[[]", "*": "[*]", "?": "[?]"})


def moving(settings: Any, scene: Any) -> list[Any]:
    """The objects chosen to move that are still there; empty: everything moves."""
    return [item.object for item in settings.moving if item.object is not None and item.object.users_scene]


def parts(chosen: Sequence[Any], depsgraph: Any) -> list[str]:
    """Globs of the parts of a dataset that the chosen objects become: themselves, and what they instance."""
    wanted = set(chosen)
    instancers = set()
    for instance in depsgraph.object_instances:
        if instance.is_instance and instance.parent is not None and instance.parent.original in wanted:
            instancers.add(instance.parent.original)
    globs = []
    for obj in chosen:
        name = obj.name.translate(_GLOB)
        if obj.type not in ("EMPTY", "POINTCLOUD"):
            globs.append(name)
        if obj in instancers:
            globs.append(f"{name}/*")
    return globs


def previewed(view_layer: Any) -> list[Any]:
    """The mesh objects that are visible here and in renders, in order; not splats, not those of a library."""
    return [
        obj
        for obj in view_layer.objects
        if obj.type == "MESH"
        and obj.visible_get(view_layer=view_layer)
        and not obj.hide_render
        and obj.library is None
        and names.MARK not in obj
    ]


def bodies(objects: Sequence[Any], depsgraph: Any, group: str = "") -> list[Body]:
    """The objects as they are evaluated now, in world space, with the weights of one vertex group."""
    made = []
    for obj in objects:
        evaluated = obj.evaluated_get(depsgraph)
        mesh = evaluated.data
        local = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", local)
        matrix = np.array(evaluated.matrix_world, np.float64)
        world = local.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        weights = _weights(obj, mesh, group) if group else None
        groups = {} if weights is None else {group: weights}
        made.append(Body(obj.name, world, np.zeros((0, 3), np.int32), np.ones(len(world)), groups))
    return made


def to_local(obj: Any, depsgraph: Any, vectors: np.ndarray) -> np.ndarray:
    """World displacements [..., 3] in the object's own axes."""
    linear = np.array(obj.evaluated_get(depsgraph).matrix_world, np.float64)[:3, :3]
    return np.asarray(vectors @ np.linalg.pinv(linear).T)


def box(objects: Sequence[Any], depsgraph: Any) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner [3] of the objects' bounding boxes, world axes. ValueError without any."""
    corners = [
        np.array(obj.matrix_world @ _vector(corner))
        for obj in (each.evaluated_get(depsgraph) for each in objects)
        for corner in obj.bound_box
    ]
    if not corners:
        raise ValueError("there is no object with a size")
    return np.min(corners, axis=0), np.max(corners, axis=0)


def _vector(corner: Sequence[float]) -> Any:
    from mathutils import Vector

    return Vector(corner)


def _weights(obj: Any, mesh: Any, group: str) -> np.ndarray | None:
    """[V] of a vertex group; None where no vertex is in it."""
    found = obj.vertex_groups.get(group)
    if found is None:
        return None
    weights = np.zeros(len(mesh.vertices))
    for i, vertex in enumerate(mesh.vertices):
        for entry in vertex.groups:
            if entry.group == found.index:
                weights[i] = entry.weight
    return weights if weights.any() else None


def unsaved_images() -> list[str]:
    """Names of images that were painted on and not saved: a copy of the file lacks what was painted."""
    return [image.name for image in bpy.data.images if image.is_dirty and image.source != "VIEWER"]
