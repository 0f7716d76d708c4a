"""What is drawn as one mesh: for modifiers after ours, and as an object of its own."""

from __future__ import annotations

from typing import Any

import bmesh
import bpy

from .. import compat, names
from ..nodes import scene


def modifiers_after(obj: Any) -> list[str]:
    """Names of modifiers after ours that see meshes alone, while what we draw is instances or points."""
    ours = scene.splat_modifier(obj)
    if ours is None or compat.get_input(ours, names.SOLID_COLOUR):
        return []
    after = list(obj.modifiers)[obj.modifiers.find(ours.name) + 1 :]
    return [other.name for other in after if other.type != "NODES"]


def make(obj: Any, collection: Any, context: Any) -> Any:
    """An object with a mesh of what the splat object draws in the current frame, in the object's place."""
    modifier = scene.splat_modifier(obj)
    before = compat.get_input(modifier, names.SOLID_COLOUR)
    compat.set_input(modifier, names.SOLID_COLOUR, True)
    try:
        depsgraph = context.evaluated_depsgraph_get()
        depsgraph.update()
        evaluated = obj.evaluated_get(depsgraph)
        mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
    finally:
        compat.set_input(modifier, names.SOLID_COLOUR, before)
    _drop_loose(mesh)  # the points themselves
    made = bpy.data.objects.new(f"{obj.name} mesh", mesh)
    made.matrix_world = obj.matrix_world
    collection.objects.link(made)
    return made


def _drop_loose(mesh: Any) -> None:
    edited = bmesh.new()
    try:
        edited.from_mesh(mesh)
        loose = [vertex for vertex in edited.verts if not vertex.link_edges]
        bmesh.ops.delete(edited, geom=loose, context="VERTS")
        edited.to_mesh(mesh)
    finally:
        edited.free()
