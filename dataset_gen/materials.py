"""Shader trees as code: the look of a surface, and the material of the data passes."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from . import compat
from .scene import BlenderSky, Environment, Gradient, Surface

LINEAR = "Linear Rec.709"
DISPLACEMENT = "displacement"  # name of the vertex attribute and of the AOV it feeds


def new_image(name: str, pixels: np.ndarray, space: str) -> bpy.types.Image:
    """An image inside Blender from [H, W] or [H, W, 3], in a colour space; row 0 is v = 0, as Blender stores it.

    8 bits of 0..1, or floats where the space is LINEAR.
    """
    height, width = pixels.shape[:2]
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels if pixels.ndim == 3 else pixels[..., None]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=space == LINEAR)
    image.colorspace_settings.name = space
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image


def _empty_tree(name: str) -> tuple[bpy.types.Material, bpy.types.NodeTree]:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, material.node_tree


def surface_material(surface: Surface) -> bpy.types.Material:
    """Principled shader with the painted pattern and, where there is one, the relief as a bump."""
    material, tree = _empty_tree(surface.name)
    nodes, links = tree.nodes, tree.links
    shader, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    _reflection(tree, shader, surface)
    colour = nodes.new("ShaderNodeTexImage")
    colour.image = new_image(f"{surface.name} colour", surface.colour, "sRGB")
    links.new(colour.outputs["Color"], shader.inputs["Base Color"])
    if surface.relief is not None:
        relief, bump = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeBump")
        relief.image = new_image(f"{surface.name} relief", surface.relief, "Non-Color")
        bump.inputs["Distance"].default_value = surface.relief_depth
        links.new(relief.outputs["Color"], bump.inputs["Height"])
        links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    return material


def _reflection(tree: bpy.types.NodeTree, shader: bpy.types.Node, surface: Surface) -> None:
    for socket, value in (
        ("Metallic", surface.metallic),
        ("Coat Weight", surface.coat),
        ("Coat Roughness", surface.coat_roughness),
        ("Transmission Weight", surface.transmission),
        ("IOR", surface.ior),
        ("Subsurface Weight", surface.subsurface),
        ("Subsurface Scale", surface.subsurface_radius),
        ("Sheen Weight", surface.sheen),
    ):
        shader.inputs[socket].default_value = value
    if isinstance(surface.roughness, np.ndarray):
        rough = tree.nodes.new("ShaderNodeTexImage")
        rough.image = new_image(f"{surface.name} roughness", surface.roughness, "Non-Color")
        tree.links.new(rough.outputs["Color"], shader.inputs["Roughness"])
    else:
        shader.inputs["Roughness"].default_value = surface.roughness


def trees(roots: Iterable[bpy.types.NodeTree | None]) -> list[bpy.types.NodeTree]:
    """The node trees and all groups inside them, each once."""
    found: list[bpy.types.NodeTree] = []
    todo = [tree for tree in roots if tree is not None]
    while todo:
        tree = todo.pop()
        if tree not in found:
            found.append(tree)
            todo += [node.node_tree for node in tree.nodes if getattr(node, "node_tree", None)]
    return found


def data_material() -> bpy.types.Material:
    """Plain surface whose AOV is the displacement: what the truth render puts on everything.

    Without a bump node the Normal pass is the smooth normal of the mesh.
    """
    material, tree = _empty_tree("tg4mm data")
    nodes, links = tree.nodes, tree.links
    # A closure is needed: Cycles averages the Normal pass over closures, and an emission has none.
    shader, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    attribute, aov = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeOutputAOV")
    attribute.attribute_name = DISPLACEMENT
    aov.aov_name = DISPLACEMENT
    links.new(attribute.outputs["Vector"], aov.inputs["Color"])
    return material


def world(sky: Gradient | BlenderSky | Environment) -> bpy.types.World:
    """The world that lights the scene."""
    made = bpy.data.worlds.new("sky")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    if isinstance(sky, Gradient):
        _gradient(tree, background, sky)
        made.cycles.sampling_method = "NONE"  # smooth: no importance map needed
        return made
    background.inputs["Strength"].default_value = sky.strength
    if isinstance(sky, BlenderSky):
        light = tree.nodes.new("ShaderNodeTexSky")
        compat.use_physical_sky(light)
        light.sun_elevation, light.sun_rotation = sky.sun_elevation, sky.sun_rotation
        light.sun_size = sky.sun_size
    else:
        light = tree.nodes.new("ShaderNodeTexEnvironment")
        light.image = new_image("environment", sky.pixels, LINEAR)
    tree.links.new(light.outputs["Color"], background.inputs["Color"])
    return made


def _gradient(tree: bpy.types.NodeTree, background: bpy.types.Node, sky: Gradient) -> None:
    """Colour by the height of the direction."""
    nodes, links = tree.nodes, tree.links
    direction, split = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeSeparateXYZ")
    height, ramp = nodes.new("ShaderNodeMapRange"), nodes.new("ShaderNodeValToRGB")
    height.inputs["From Min"].default_value = -1.0
    stops = ramp.color_ramp.elements
    while len(stops) < len(sky.colours):
        stops.new(0.5)
    for i, rgb in enumerate(sky.colours):
        stops[i].position = i / (len(sky.colours) - 1)
        stops[i].color = (*rgb, 1.0)
    links.new(direction.outputs["Generated"], split.inputs["Vector"])
    links.new(split.outputs["Z"], height.inputs["Value"])
    links.new(height.outputs["Result"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], background.inputs["Color"])
