"""The user's materials as copies that can be rendered anywhere, and what had to be changed in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import bpy

from ..materials import trees
from .anchors import Anchors, own_groups
from .images import list_names, repair_images

_SUFFIX = " tg4mm"  # of our copies of materials while the originals are there


class MaterialCopies:
    """Our own copies of the user's materials, repaired and anchored; each is made when it is asked for."""

    def __init__(self, anchors: Anchors, warnings: list[str]) -> None:
        self._anchors, self._warnings = anchors, warnings
        self._made: dict[bpy.types.Material | None, bpy.types.Material | None] = {}
        self._groups: dict[bpy.types.NodeTree, bpy.types.NodeTree] = {}
        self._anchored: set[bpy.types.NodeTree] = set()
        self._displaced: set[str] = set()
        self._volumes: set[str] = set()
        self._lost: set[str] = set()

    def material(self, original: bpy.types.Material | None) -> bpy.types.Material | None:
        """The copy to be used. None if the material is a volume without a surface."""
        if original not in self._made:
            self._made[original] = _plain("tg4mm grey") if original is None else self._copy(original)
        return self._made[original]

    @property
    def made(self) -> list[bpy.types.Material]:
        return [material for material in self._made.values() if material is not None]

    def _copy(self, original: bpy.types.Material) -> bpy.types.Material | None:
        material = original.copy()
        material.name = f"{original.name}{_SUFFIX}"
        material.animation_data_clear()
        if not has_nodes(material) or material.node_tree is None:
            _from_viewport(material)
        elif any(map(_is_lost, trees([material.node_tree]))):
            _from_viewport(material)
            self._lost.add(original.name)
        tree = material.node_tree
        tree.animation_data_clear()
        own_groups(tree, self._groups)
        for each in trees([tree]):
            if each not in self._anchored:
                self._anchored.add(each)
                self._anchors.rewrite(each)
        output = tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
        if output is None:
            return material
        if not self._only_a_surface(tree, output, original.name):
            return None
        if output.inputs["Displacement"].is_linked and material.displacement_method != "BUMP":
            material.displacement_method = "BUMP"
            self._displaced.add(original.name)
        return material

    def _only_a_surface(self, tree: bpy.types.NodeTree, output: bpy.types.Node, name: str) -> bool:
        volume = output.inputs["Volume"]
        if volume.is_linked:
            self._volumes.add(name)
            for link in list(volume.links):
                tree.links.remove(link)
            return bool(output.inputs["Surface"].is_linked)
        return True

    def rename(self) -> None:
        """Gives the copies the names of the originals, once these are gone."""
        for material in bpy.data.materials:
            material.name = material.name.removesuffix(_SUFFIX)

    def report(self) -> None:
        """Adds the warnings about all materials that were made."""
        self._warnings += repair_images(trees(m.node_tree for m in self.made))
        for names, text in (
            (self._lost, "part of their nodes is lost with a library, a plain colour takes their place"),
            (self._displaced, "true displacement is rendered as a bump, which truth does not see"),
            (self._volumes, "volumes are left out"),
            (
                using(self.made, _transparent),
                "transparent places are surface to truth, which sees whole faces",
            ),
            (using(self.made, _glassy), "truth sees the surface of glass, not what lies behind it"),
        ):
            if names:
                self._warnings.append(f"materials {list_names(names)}: {text}")
        if self._anchors.unanchored:
            self._warnings.append(
                f"materials read {list_names(self._anchors.unanchored)}: what that gives may differ"
            )


def _is_lost(tree: bpy.types.NodeTree) -> bool:
    """Whether a tree stands for one in a missing library."""
    return bool(tree.is_missing)


def _plain(name: str) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    _from_viewport(material)
    return material


def has_nodes(block: bpy.types.Material | bpy.types.World) -> bool:
    """Whether its look comes from nodes; from 5.0 on it always does."""
    return bpy.app.version >= (5, 0, 0) or bool(block.use_nodes)


def _from_viewport(material: bpy.types.Material) -> None:
    """A Principled shader with the colour that the viewport shows: of files without nodes."""
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new("ShaderNodeBsdfPrincipled"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    shader.inputs["Base Color"].default_value = (*material.diffuse_color[:3], 1.0)
    shader.inputs["Metallic"].default_value = material.metallic
    shader.inputs["Roughness"].default_value = material.roughness


def using(materials: Iterable[bpy.types.Material], test: Callable[[bpy.types.Node], bool]) -> set[str]:
    """Names of the materials with a node, in groups too, that passes the test."""
    return {
        material.name.removesuffix(_SUFFIX)
        for material in materials
        if any(test(node) for tree in trees([material.node_tree]) for node in tree.nodes)
    }


def above(node: bpy.types.Node, socket: str, least: float = 0.0) -> bool:
    """Whether a socket's value is linked or above a number."""
    found = node.inputs.get(socket)
    return found is not None and (found.is_linked or found.default_value > least)


def _transparent(node: bpy.types.Node) -> bool:
    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        alpha = node.inputs["Alpha"]
        return bool(alpha.is_linked or alpha.default_value < 1.0)
    return node.bl_idname == "ShaderNodeBsdfTransparent" and bool(node.outputs[0].links)


def _glassy(node: bpy.types.Node) -> bool:
    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        return above(node, "Transmission Weight")
    return node.bl_idname in ("ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction") and bool(
        node.outputs[0].links
    )
