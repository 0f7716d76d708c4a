"""A splat file as a Blender object: loose vertices with attributes, a node tree, an emission material."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from . import nodes
from .core.splatfile import SplatFile

MODIFIER = "TG4MM"
MARK = "tg4mm_version"  # custom property that tells our objects; FPS and FREQUENCIES go with it
FPS, FREQUENCIES = "tg4mm_fps", "tg4mm_frequencies_hz"
C0 = 0.28209479177387814  # Y_00, the constant spherical harmonic: 1 / (2 √π)


def make_object(splat: SplatFile, name: str, collection: Any) -> Any:
    """Make the object and link it to `collection`. If anything fails, nothing made here is left."""
    made: list[tuple[Any, Any]] = []  # (block, the list it was made in)
    try:
        mesh = _keep(made, bpy.data.meshes, bpy.data.meshes.new(name))
        fill_mesh(mesh, splat)
        material = _keep(made, bpy.data.materials, make_material(name))
        tree = nodes.build_tree(name, splat.freqs_hz.tolist(), splat.fps, material)
        _keep(made, bpy.data.node_groups, tree)
        mesh.materials.append(material)
        obj = _keep(made, bpy.data.objects, bpy.data.objects.new(name, mesh))
        obj[MARK], obj[FPS], obj[FREQUENCIES] = 1, splat.fps, splat.freqs_hz.tolist()
        obj.modifiers.new(MODIFIER, "NODES").node_group = tree
        collection.objects.link(obj)
    except BaseException:
        for block, blocks in reversed(made):
            blocks.remove(block)
        raise
    return obj


def splat_modifier(obj: Any) -> Any | None:
    """The modifier that moves the object's splats; None if the object is not one of ours."""
    if obj is None or MARK not in obj:
        return None
    return obj.modifiers.get(MODIFIER)


def set_timeline(scene: Any, splat: SplatFile) -> None:
    """Frame 1 … T at the file's frame rate; a file without motion leaves the timeline as it is."""
    if splat.n_modes == 0:
        return
    scene.render.fps = max(1, math.ceil(splat.fps))
    scene.render.fps_base = scene.render.fps / splat.fps
    scene.frame_start, scene.frame_end = 1, max(1, splat.n_timesteps)


def fill_mesh(mesh: Any, splat: SplatFile) -> None:
    """Rest positions as vertices, all else as point attributes that the node tree names."""
    n = len(splat)
    mesh.vertices.add(n)
    mesh.vertices.foreach_set("co", _flat(splat.means))
    quats = splat.quats / np.linalg.norm(splat.quats, axis=1, keepdims=True)
    _attribute(mesh, nodes.SCALE, "FLOAT_VECTOR", "vector", splat.scales)
    _attribute(mesh, nodes.ROTATION, "QUATERNION", "value", quats)
    _attribute(mesh, nodes.COLOUR, "FLOAT_COLOR", "color", linear_colours(splat.sh))
    _attribute(mesh, nodes.OPACITY, "FLOAT", "value", splat.opacities)
    for k in range(splat.n_modes):
        names, d, r = nodes.phasor_names(k), splat.displacement[k], splat.rotation[k]
        for part, values in (("re", d.real), ("im", d.imag), ("re_r", r.real), ("im_r", r.imag)):
            _attribute(mesh, names[part], "FLOAT_VECTOR", "vector", values)
    mesh.update()


def linear_colours(sh: np.ndarray) -> np.ndarray:
    """[N, 4] scene-linear RGBA of sh [N, K, 3]: the part that does not depend on the view, sRGB decoded.

    Spherical harmonics of [3DGS] give display-referred sRGB, 0.5 + C0·sh_0; emission needs linear light.
    """
    srgb = np.clip(0.5 + C0 * sh[:, 0].astype(np.float64), 0.0, 1.0)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return np.concatenate([linear, np.ones((len(sh), 1))], axis=1)


def make_material(name: str) -> Any:
    """Emission in the colour of each point, read from the instance."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    colour = tree.nodes.new("ShaderNodeAttribute")
    colour.attribute_type, colour.attribute_name = "INSTANCER", nodes.COLOUR
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(colour.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    for i, node in enumerate((colour, emission, output)):
        node.location = 200 * i, 0
    return material


def _attribute(mesh: Any, name: str, data_type: str, field: str, values: np.ndarray) -> None:
    mesh.attributes.new(name, data_type, "POINT").data.foreach_set(field, _flat(values))


def _flat(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float32).ravel()


def _keep(made: list[tuple[Any, Any]], blocks: Any, block: Any) -> Any:
    made.append((block, blocks))
    return block
