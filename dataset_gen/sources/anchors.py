"""Nails what a material reads from space to the surface.

A texture in object, generated or world coordinates would stay where it is while the surface vibrates
through it, and all of these change when an object is replaced by a mesh in world space. So they are written
into vertex attributes at rest, and the materials read those instead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..build import DISPLACEMENT
from .gather import Piece

_LOCAL, _GENERATED, _WORLD = "tg4mm local", "tg4mm generated", "tg4mm world"
_LOCATION, _RANDOM = "tg4mm location", "tg4mm random"
_ALIAS = "tg4mm user displacement"  # a user's attribute that has the name of ours
_SCALARS = {_RANDOM}
# Textures that read Generated coordinates where nothing is linked.
_PROCEDURAL = {
    f"ShaderNodeTex{kind}"
    for kind in ("Noise", "Voronoi", "Wave", "Magic", "Musgrave", "Gradient", "Checker", "Brick", "Gabor")
}


@dataclass
class Anchors:
    """Which attributes the rewritten materials read."""

    needed: set[str] = field(default_factory=set)
    frames: dict[str, np.ndarray] = field(default_factory=dict)  # attribute → world to an object's axes
    unanchored: set[str] = field(default_factory=set)  # what still reads from space

    def rewrite(self, tree: bpy.types.NodeTree) -> None:
        """Replaces what reads from space in one node tree; groups inside are the caller's."""
        for node in list(tree.nodes):
            kind = node.bl_idname
            if kind == "ShaderNodeTexCoord":
                self._replace(tree, node.outputs["Generated"], _GENERATED)
                self._replace(tree, node.outputs["Object"], self._frame(node.object))
            elif kind == "ShaderNodeNewGeometry":
                self._replace(tree, node.outputs["Position"], _WORLD)
            elif kind == "ShaderNodeObjectInfo":
                self._replace(tree, node.outputs["Location"], _LOCATION)
                self._replace(tree, node.outputs["Random"], _RANDOM)
            elif kind in _PROCEDURAL and not node.inputs["Vector"].is_linked:
                tree.links.new(self._attribute(tree, _GENERATED), node.inputs["Vector"])
            elif kind == "ShaderNodeAttribute" and node.attribute_name == DISPLACEMENT:
                node.attribute_name = _ALIAS
            elif kind == "ShaderNodeVectorTransform" and "OBJECT" in (node.convert_from, node.convert_to):
                self.unanchored.add("Vector Transform from or to object space")
            elif kind == "ShaderNodeParticleInfo":
                self.unanchored.add("Particle Info")

    def _frame(self, obj: bpy.types.Object | None) -> str:
        if obj is None:
            return _LOCAL
        name = f"tg4mm in {obj.name}"
        self.frames[name] = np.linalg.pinv(np.array(obj.matrix_world, np.float64))
        return name

    def _attribute(self, tree: bpy.types.NodeTree, name: str) -> bpy.types.NodeSocket:
        self.needed.add(name)
        node = tree.nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Fac" if name in _SCALARS else "Vector"]

    def _replace(self, tree: bpy.types.NodeTree, output: bpy.types.NodeSocket, name: str) -> None:
        targets = [link.to_socket for link in output.links]
        if targets:
            source = self._attribute(tree, name)
            for target in targets:
                tree.links.new(source, target)

    def write(
        self, mesh: bpy.types.Mesh, pieces: Sequence[Piece], local: np.ndarray, world: np.ndarray
    ) -> None:
        """Writes what is needed on a mesh made of pieces of one shape, one after the other.

        `local` and `world` [V, 3] are its vertices in the two frames.
        """
        _free_the_name(mesh)
        each = len(world) // len(pieces)
        values: dict[str, Callable[[], np.ndarray]] = {
            _LOCAL: lambda: local,
            _GENERATED: lambda: np.tile(pieces[0].shape.generated, (len(pieces), 1)),
            _WORLD: lambda: world,
            _LOCATION: lambda: np.repeat([piece.matrix[:3, 3] for piece in pieces], each, 0),
            _RANDOM: lambda: np.repeat([piece.random for piece in pieces], each),
        }
        for name in sorted(self.needed):
            if name in self.frames:
                frame = self.frames[name]
                value = world @ frame[:3, :3].T + frame[:3, 3]
            else:
                value = values[name]()
            kind = "FLOAT" if name in _SCALARS else "FLOAT_VECTOR"
            data = mesh.attributes.new(name, kind, "POINT").data
            data.foreach_set("value" if name in _SCALARS else "vector", value.astype(np.float32).ravel())


def _free_the_name(mesh: bpy.types.Mesh) -> None:
    """Our displacement takes its name; a user's attribute of that name gets another."""
    if (clash := mesh.attributes.get(DISPLACEMENT)) is not None:
        clash.name = _ALIAS


def own_groups(tree: bpy.types.NodeTree, copies: dict[bpy.types.NodeTree, bpy.types.NodeTree]) -> None:
    """Gives a tree copies of its groups, shared through `copies`: a linked library's cannot be changed."""
    for node in tree.nodes:
        group = getattr(node, "node_tree", None)
        if group is None or group in copies.values():
            continue
        if group not in copies:
            copies[group] = group.copy()
            copies[group].animation_data_clear()
            own_groups(copies[group], copies)
        node.node_tree = copies[group]
