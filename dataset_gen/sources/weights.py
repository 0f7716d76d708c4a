"""Vertex group weights as arrays. Blender hands them out vertex by vertex; geometry nodes, all at once."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

_TARGET = "tg4mm weight {}"


def group_weights(objects: Sequence[bpy.types.Object]) -> list[dict[str, np.ndarray]]:
    """For each mesh object of the context's scene: group name → weights [V] float64, 0 where not assigned.

    The objects must have no modifiers.
    """
    named = [[group.name for group in obj.vertex_groups] for obj in objects]
    trees: dict[tuple[str, ...], bpy.types.NodeTree] = {}
    for obj, names in zip(objects, named, strict=True):
        if names:
            key = tuple(names)
            if key not in trees:
                trees[key] = _converter(names)
            obj.modifiers.new("weights", "NODES").node_group = trees[key]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = [_read(obj.evaluated_get(depsgraph), names) for obj, names in zip(objects, named, strict=True)]
    for obj, names in zip(objects, named, strict=True):
        if names:
            obj.modifiers.clear()
    for tree in trees.values():
        bpy.data.node_groups.remove(tree)
    return found


def _converter(names: Sequence[str]) -> bpy.types.NodeTree:
    """Nodes that store every vertex group as a plain attribute of the points."""
    tree = bpy.data.node_groups.new("tg4mm weights", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    geometry = tree.nodes.new("NodeGroupInput").outputs[0]
    for i, name in enumerate(names):
        source, store = (
            tree.nodes.new(f"GeometryNode{kind}") for kind in ("InputNamedAttribute", "StoreNamedAttribute")
        )
        source.data_type = store.data_type = "FLOAT"
        store.domain = "POINT"
        source.inputs["Name"].default_value = name
        store.inputs["Name"].default_value = _TARGET.format(i)
        tree.links.new(geometry, store.inputs["Geometry"])
        value = next(socket for socket in source.outputs if socket.name == "Attribute" and socket.enabled)
        tree.links.new(value, next(s for s in store.inputs if s.name == "Value" and s.enabled))
        geometry = store.outputs["Geometry"]
    tree.links.new(geometry, tree.nodes.new("NodeGroupOutput").inputs[0])
    return tree


def _read(obj: bpy.types.Object, names: Sequence[str]) -> dict[str, np.ndarray]:
    mesh, found = obj.data, {}
    for i, name in enumerate(names):
        weights = np.empty(len(mesh.vertices), np.float32)
        mesh.attributes[_TARGET.format(i)].data.foreach_get("value", weights)
        found[name] = weights.astype(np.float64)
    return found
