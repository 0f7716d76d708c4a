"""The scene's objects as the generator sees them: moving objects, part names, bounds."""

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from dataset_gen.errors import GenerateError

from .. import names

_GLOB = str.maketrans({"[": "[[]", "*": "[*]", "?": "[?]"})
PLACES, HEADINGS, HEIGHTS = ("point", "tip"), ("axis", "direction"), ("level",)


def moving(settings: Any) -> list[Any]:
    """Return the existing objects selected to move; empty if everything moves."""
    return [item.object for item in settings.moving if item.object is not None and item.object.users_scene]


def parts(chosen: Sequence[Any], depsgraph: Any) -> list[str]:
    """Return globs of the dataset parts that the chosen objects and their instances become."""
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


def visible_meshes(view_layer: Any) -> list[Any]:
    """Return the mesh objects visible here and in renders, without splats and linked objects."""
    return [
        obj
        for obj in view_layer.objects
        if obj.type == "MESH"
        and obj.visible_get(view_layer=view_layer)
        and not obj.hide_render
        and obj.library is None
        and names.MARK not in obj
    ]


def box(objects: Sequence[Any], depsgraph: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner [3] of the objects' bounds in world axes. Raises GenerateError if empty."""
    corners = [
        np.array(obj.matrix_world @ _vector(corner))
        for obj in (each.evaluated_get(depsgraph) for each in objects)
        for corner in obj.bound_box
    ]
    if not corners:
        raise GenerateError("the objects have no extent")
    return np.min(corners, axis=0), np.max(corners, axis=0)


def _vector(corner: Sequence[float]) -> Any:
    from mathutils import Vector

    return Vector(corner)


def unsaved_images() -> list[str]:
    """Return the names of images with unsaved painting, which a copy of the file lacks."""
    return [image.name for image in bpy.data.images if image.is_dirty and image.source != "VIEWER"]


def fit(settings: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Fit the selected kind's fields to a box with these corners [3]. Raises GenerateError if it has no size."""
    size = high - low
    if not size.max() > 0:
        raise GenerateError("the objects have no extent")
    thin, middle, long = np.argsort(size, kind="stable")
    centre = 0.5 * (low + high)
    foot, top = centre.copy(), centre.copy()
    if settings.kind in ("bending", "twist"):
        foot[long], top[long] = low[long], high[long]
        _set(settings, axis=_unit(long), direction=_unit(thin), length=float(size[long]))
    elif settings.kind in ("membrane", "plate"):
        foot = centre
        sides = size[long], max(size[middle], 1e-6)
        _set(settings, axis=_unit(thin), direction=_unit(long), sides=sides, radius=0.5 * float(size[middle]))
    else:
        foot[2], top[2] = low[2], high[2]
        _set(settings, axis=_unit(1 if settings.kind == "rock" else 2))
    is_wave = settings.kind == "wave"
    wavelength = 0.5 * float(size.max())
    _set(settings, point=foot, tip=top, wavelength=wavelength, level=float((high if is_wave else low)[2]))
    _set(settings, reach=float(max(size[2], 1e-6)))


def chosen(context: Any) -> list[Any]:
    """Return the objects to fit to: the moving ones, else the active one, else all visible ones."""
    settings = context.scene.tg4mm_generate
    if found := moving(settings):
        return found
    active = context.object
    return [active] if active is not None else visible_meshes(context.view_layer)


def from_cursor(settings: Any, name: str, cursor: Any) -> None:
    """Set one field from the 3D cursor: a position, a direction (its z axis) or a height (its z)."""
    if name in PLACES:
        setattr(settings, name, cursor.matrix.translation)
    elif name in HEADINGS:
        setattr(settings, name, cursor.matrix.col[2][:3])
    elif name in HEIGHTS:
        setattr(settings, name, cursor.matrix.translation[2])
    else:
        raise ValueError(f"{name!r} is not one of {', '.join((*PLACES, *HEADINGS, *HEIGHTS))}")


def _set(settings: Any, **values: Any) -> None:
    for name, value in values.items():
        setattr(settings, name, value)


def _unit(axis: int) -> tuple[float, ...]:
    return tuple(np.eye(3)[axis].tolist())
