"""The light of a user's file: its world, what glows in it, and the brightness that its exposure gave it."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..materials import trees
from ..materials import world as made_world
from ..scene import Gradient
from .anchors import own_groups
from .copies import above, has_nodes, using
from .images import repair_images

SKY = Gradient(((0.35, 0.34, 0.33), (0.7, 0.7, 0.7), (1.0, 1.0, 1.0)))  # of scenes without any light
# Where a node says how much light it gives.
_STRENGTH = {
    "ShaderNodeBackground": "Strength",
    "ShaderNodeEmission": "Strength",
    "ShaderNodeBsdfPrincipled": "Emission Strength",
}


def own_world(scene: bpy.types.Scene, lit: bool, warnings: list[str]) -> bpy.types.World:
    """The scene's world as a copy with nodes; a grey sky instead if there is no other light at all."""
    world = scene.world.copy() if scene.world else None
    if world is not None:
        world.animation_data_clear()
        if not has_nodes(world) or world.node_tree is None:
            _world_from_colour(world)
        world.node_tree.animation_data_clear()
        own_groups(world.node_tree, {})
        warnings += repair_images(trees([world.node_tree]))
        output = world.node_tree.get_output_node("CYCLES") or world.node_tree.get_output_node("ALL")
        if output is not None and output.inputs["Volume"].is_linked:
            world.node_tree.links.remove(output.inputs["Volume"].links[0])
            warnings.append(f"world {scene.world.name}: its volume is left out")
        if lit or any(_shines(node) for tree in trees([world.node_tree]) for node in tree.nodes):
            return world
    elif lit:
        world = bpy.data.worlds.new("black")
        world.color = (0.0, 0.0, 0.0)
        _world_from_colour(world)
        return world
    warnings.append("the file holds no light at all: a grey sky lights it")
    return made_world(SKY)


def _world_from_colour(world: bpy.types.World) -> None:
    colour = tuple(world.color)
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (*colour, 1.0)
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])


def _shines(node: bpy.types.Node) -> bool:
    if node.bl_idname not in ("ShaderNodeBackground", "ShaderNodeEmission") or not node.outputs[0].links:
        return False
    colour = node.inputs["Color"]
    return above(node, "Strength") and (colour.is_linked or any(colour.default_value[:3]))


def glows(materials: Iterable[bpy.types.Material]) -> bool:
    """Whether any of the materials gives light."""
    return bool(using(materials, _glows))


def _glows(node: bpy.types.Node) -> bool:
    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        colour = node.inputs["Emission Color"]
        black = not colour.is_linked and not any(colour.default_value[:3])
        return above(node, "Emission Strength") and not black
    return node.bl_idname == "ShaderNodeEmission" and bool(node.outputs[0].links) and above(node, "Strength")


def brighten(all_trees: Iterable[bpy.types.NodeTree], factor: float) -> None:
    """Makes all that gives light in the trees brighter by a factor; a world or material, not a lamp's."""
    for tree in all_trees:
        for node in list(tree.nodes):
            strength = node.inputs.get(_STRENGTH.get(node.bl_idname, ""))
            if strength is None:
                continue
            if not strength.is_linked:
                strength.default_value *= factor
                continue
            scaled = tree.nodes.new("ShaderNodeMath")
            scaled.operation = "MULTIPLY"
            tree.links.new(strength.links[0].from_socket, scaled.inputs[0])
            scaled.inputs[1].default_value = factor
            tree.links.new(scaled.outputs[0], strength)
