"""How far light has to be followed: looks for materials that let it through, which costs time otherwise wasted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import bpy

_TRANSMITS = {"ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction", "ShaderNodeBsdfTranslucent"}
_TRANSPARENT = {"ShaderNodeBsdfTransparent", "ShaderNodeBsdfRayPortal", "ShaderNodeHoldout"}


@dataclass(frozen=True)
class Bounces:
    """Cycles' limits, in bounces of one light path."""

    total: int = 4
    diffuse: int = 2
    glossy: int = 3
    transmission: int = 0
    transparent: int = 0

    def apply(self, scene: bpy.types.Scene) -> None:
        """Sets the scene's limits."""
        cycles = scene.cycles
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = (
            self.total,
            self.diffuse,
            self.glossy,
        )
        cycles.transmission_bounces, cycles.transparent_max_bounces = self.transmission, self.transparent
        cycles.volume_bounces = 0


OPAQUE = Bounces()
GLASS = Bounces(total=10, diffuse=2, glossy=4, transmission=8, transparent=8)
CUT_OUT = Bounces(transparent=8)  # leaves cut out of a rectangle by alpha: passing through is no bounce


def bounces_for(scene: bpy.types.Scene) -> Bounces:
    """The least that shows every material of the scene's objects."""
    if transmitting(scene):
        return GLASS
    return CUT_OUT if any(map(_cut_out, _used(scene))) else OPAQUE


def transmitting(scene: bpy.types.Scene) -> list[bpy.types.Material]:
    """Materials of the scene's objects that light goes through with a turn: glass, water, thin leaves."""
    return [material for material in _used(scene) if any(map(_transmits, nodes_of(material)))]


def _used(scene: bpy.types.Scene) -> list[bpy.types.Material]:
    used = {s.material.name: s.material for obj in scene.objects for s in obj.material_slots if s.material}
    return list(used.values())


def _transmits(node: bpy.types.Node) -> bool:
    weight = _principled(node, "Transmission Weight")
    return node.bl_idname in _TRANSMITS or _is_not(weight, 0.0)


def _cut_out(material: bpy.types.Material) -> bool:
    nodes = nodes_of(material)
    return any(n.bl_idname in _TRANSPARENT or _is_not(_principled(n, "Alpha"), 1.0) for n in nodes)


def _is_not(socket: bpy.types.NodeSocket | None, value: float) -> bool:
    """Whether there is such a socket and it may have another value."""
    return socket is not None and bool(socket.is_linked or socket.default_value != value)


def _principled(node: bpy.types.Node, socket: str) -> bpy.types.NodeSocket | None:
    return node.inputs.get(socket) if node.bl_idname == "ShaderNodeBsdfPrincipled" else None


def nodes_of(material: bpy.types.Material) -> Iterator[bpy.types.Node]:
    """All nodes of a material, those inside groups too."""
    trees, seen = [material.node_tree] if material.node_tree else [], set()
    while trees:
        tree = trees.pop()
        if tree.name in seen:
            continue
        seen.add(tree.name)
        for node in tree.nodes:
            yield node
            if node.type == "GROUP" and node.node_tree:
                trees.append(node.node_tree)
