"""Materials of splats, scene settings for blending as trained, and pictures from pixel arrays."""

from typing import Any

import bpy
import numpy as np

from .. import compat, names
from . import Materials, changes, scene
from .graph import Graph, Made
from .shapes import DRAW_MODES

# For true splats Cycles counts two bounces a Gaussian, and shows black where they end: as many as it allows. Before the
# least number it ends no path by chance, which would be seen as noise.
TRANSPARENT_BOUNCES = 1024
_FACTOR = 2  # the Attribute node's output, "Fac" in 4.5 and "Factor" in 5.2
SAMPLES = 64  # of what is see-through: with 4 Cycles is 6 dB farther off, with 16 EEVEE's view shows grain


def make_materials(name: str, made: Made) -> Materials:
    """Create the three materials and record them in `made`."""
    return Materials(
        solid=_emission(name, "INSTANCER", made),
        splat=_splat(f"{name} splat", made),
        points=_emission(f"{name} points", "GEOMETRY", made),
    )


def _emission(name: str, where: str, made: Made) -> Any:
    """Add an emission shader coloured by the attribute of the instance (INSTANCER) or the mesh (GEOMETRY)."""
    material, graph = _new(name, made)
    _finish(graph, _emit(graph, where))
    return material


def _splat(name: str, made: Made) -> Any:
    """Shade a Gaussian as opacity · exp(−d²/2), with d the distance, in σ, of the view ray from the centre.

    On a ball that ends at 3 σ, d = 3r with r the ray's distance from the origin in object space, where the
    ball's radius is 1. Back faces are clear, so every ray counts a Gaussian once. No camera is named: it
    holds in every view.
    """
    material, graph = _new(name, made)
    where = graph.call("ShaderNodeTexCoord", {}, "Object")
    incoming = graph.call("ShaderNodeNewGeometry", {}, "Incoming")
    to_object = {"vector_type": "VECTOR", "convert_from": "WORLD", "convert_to": "OBJECT"}
    ray = graph.call("ShaderNodeVectorTransform", {"Vector": incoming}, **to_object)
    along = _dot(graph, where, ray)
    nearest = graph.math("DIVIDE", graph.math("MULTIPLY", along, along), _dot(graph, ray, ray))
    squared = graph.math("SUBTRACT", _dot(graph, where, where), nearest)
    fall = graph.math("EXPONENT", graph.math("MULTIPLY", graph.math("MAXIMUM", squared, 0.0), -4.5))
    attribute = {"attribute_type": "INSTANCER", "attribute_name": names.OPACITY}
    opacity = graph.call("ShaderNodeAttribute", {}, _FACTOR, **attribute)
    alpha = graph.math("MULTIPLY", fall, opacity)
    front = graph.math("SUBTRACT", 1.0, graph.call("ShaderNodeNewGeometry", {}, "Backfacing"))
    mix = graph.node("ShaderNodeMixShader")
    graph.put(graph.math("MULTIPLY", alpha, front), mix.inputs[0])
    graph.put(graph.node("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
    graph.put(_emit(graph, "INSTANCER"), mix.inputs[2])
    _finish(graph, mix.outputs[0])
    material.surface_render_method = "DITHERED"
    material.use_backface_culling = True
    return material


def _emit(graph: Graph, where: str) -> Any:
    colour = graph.call("ShaderNodeAttribute", {}, "Color", attribute_type=where, attribute_name=names.COLOUR)
    return graph.call("ShaderNodeEmission", {"Color": colour})


def _dot(graph: Graph, a: Any, b: Any) -> Any:
    node = graph.node("ShaderNodeVectorMath", operation="DOT_PRODUCT")
    graph.put(a, node.inputs[0])
    graph.put(b, node.inputs[1])
    return node.outputs["Value"]


def _new(name: str, made: Made) -> tuple[Any, Graph]:
    material = made.keep(bpy.data.materials.new(name))
    compat.use_nodes(material)
    material.node_tree.nodes.clear()
    # A light tree over many thousand glowing triangles costs Cycles minutes and lights nothing here.
    material.cycles.emission_sampling = "NONE"
    return material, Graph(material.node_tree)


def _finish(graph: Graph, surface: Any) -> None:
    graph.put(surface, graph.node("ShaderNodeOutputMaterial").inputs["Surface"])
    graph.arrange()


def true_colours(to: Any, as_trained: bool | None = None) -> int:
    """Set a scene up for its splats, and how they blend.

    `as_trained`: colours blend as the screen shows them (view transform Raw), else in linear light (Standard); None: as
    the scene's splats do. Returns how many settings changed. `restore` takes it back.
    """
    if as_trained is None:
        as_trained = blends_as_trained(to)
    for obj in _splats(to):
        modifier = scene.splat_modifier(obj)
        compat.set_input(modifier, names.BLEND, as_trained)
        drawn = compat.get_input(modifier, names.DRAW)
        # Blended so, Blender's own splats have one colour for all directions: the one that the camera sees.
        if as_trained and DRAW_MODES[drawn].native and compat.has_input(modifier, names.VIEW_COLOUR):
            compat.set_input(modifier, names.VIEW_COLOUR, True)
    return changes.put(to, _needed(to))


def restore(to: Any) -> int:
    """Restore what the extension changed in the scene; return how many settings. Splats then blend in linear light."""
    for obj in _splats(to):
        compat.set_input(scene.splat_modifier(obj), names.BLEND, False)
    return changes.restore(to)


def is_set_up(of: Any) -> bool:
    """Return whether `true_colours` has nothing to change."""
    return not _needed(of)


def blends_as_trained(of: Any) -> bool:
    """Return whether the scene's splats blend as trained."""
    return any(compat.get_input(scene.splat_modifier(obj), names.BLEND) for obj in _splats(of))


def _needed(of: Any) -> dict[str, Any]:
    exact = {
        "view_settings.view_transform": "Raw" if blends_as_trained(of) else "Standard",
        "view_settings.look": "None",
        "view_settings.exposure": 0.0,
        "view_settings.gamma": 1.0,
    }
    least = dict.fromkeys(
        ("cycles.transparent_max_bounces", "cycles.min_transparent_bounces"), TRANSPARENT_BOUNCES
    )
    drawn = {compat.get_input(scene.splat_modifier(obj), names.DRAW) for obj in _splats(of)}
    if any(DRAW_MODES[name].soft for name in drawn):
        least["eevee.taa_samples"] = SAMPLES
    if any(DRAW_MODES[name].native for name in drawn):
        least |= dict.fromkeys(("cycles.samples", "eevee.taa_render_samples"), SAMPLES)
        exact |= {"display.render_aa": "32", "display.shading.light": "FLAT"}
    now = {path: changes.get(of, path) for path in (*exact, *least)}
    wrong = {path: value for path, value in exact.items() if now[path] not in (None, value)}
    few = {path: n for path, n in least.items() if now[path] is not None and now[path] < n}
    return wrong | few


def _splats(of: Any) -> list[Any]:
    modifiers = ((obj, scene.splat_modifier(obj)) for obj in of.objects)
    return [
        obj
        for obj, modifier in modifiers
        if modifier is not None and modifier.node_group and compat.has_input(modifier, names.BLEND)
    ]


def pixels(data: bytes) -> np.ndarray:
    """[H, W, channels] float32 in 0..1 of a picture file, as its numbers are, first row at the top."""
    image = bpy.data.images.new("tg4mm", 1, 1)
    try:
        image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
        image.pack(data=data, data_len=len(data))
        image.source = "FILE"
        width, height = image.size
        found = np.empty((height, width, image.channels), np.float32)
        image.pixels.foreach_get(found.ravel())
    finally:
        bpy.data.images.remove(image)
    return found[::-1]


def decode(data: bytes) -> np.ndarray:
    """[H, W, 4] uint8: lossless WebP, as SOG has it. Raises ValueError for what Blender cannot read."""
    found = pixels(data)
    if not found.any():  # what 4.5 gives for a picture that it fails to read
        raise ValueError("Blender cannot read it as a picture")
    return np.rint(found * 255).astype(np.uint8)
