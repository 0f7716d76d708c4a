"""Shader trees as code: the look of a surface, and the material of the data passes."""

from __future__ import annotations

import bpy
import numpy as np

from .scene import Surface

DISPLACEMENT = "displacement"  # name of the vertex attribute and of the AOV it feeds


def _image(name: str, pixels: np.ndarray, colour: bool) -> bpy.types.Image:
    """An image inside Blender from [H, W] or [H, W, 3] in 0..1; row 0 is v = 0, as Blender stores it."""
    height, width = pixels.shape[:2]
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels if pixels.ndim == 3 else pixels[..., None]
    image = bpy.data.images.new(name, width, height, alpha=False)
    image.colorspace_settings.name = "sRGB" if colour else "Non-Color"
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
    shader.inputs["Metallic"].default_value = surface.metallic
    shader.inputs["Roughness"].default_value = surface.roughness
    colour = nodes.new("ShaderNodeTexImage")
    colour.image = _image(f"{surface.name} colour", surface.colour, colour=True)
    links.new(colour.outputs["Color"], shader.inputs["Base Color"])
    if surface.relief is not None:
        relief, bump = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeBump")
        relief.image = _image(f"{surface.name} relief", surface.relief, colour=False)
        bump.inputs["Distance"].default_value = surface.relief_depth
        links.new(relief.outputs["Color"], bump.inputs["Height"])
        links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    return material


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


def sky(colours: tuple[tuple[float, float, float], ...]) -> bpy.types.World:
    """A world that fades from straight below through the horizon to straight above, linear RGB."""
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    background, output = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    direction, split = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeSeparateXYZ")
    height, ramp = nodes.new("ShaderNodeMapRange"), nodes.new("ShaderNodeValToRGB")
    height.inputs["From Min"].default_value = -1.0
    stops = ramp.color_ramp.elements
    while len(stops) < len(colours):
        stops.new(0.5)
    for i, rgb in enumerate(colours):
        stops[i].position = i / (len(colours) - 1)
        stops[i].color = (*rgb, 1.0)
    links.new(direction.outputs["Generated"], split.inputs["Vector"])
    links.new(split.outputs["Z"], height.inputs["Value"])
    links.new(height.outputs["Result"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    return world
