"""The materials that splats are drawn with: emission in linear light, nothing that a lamp changes."""

from __future__ import annotations

from typing import Any

import bpy

from .. import compat, names
from . import Materials
from .graph import Graph, Made

# For true splats Cycles counts two bounces a Gaussian, and shows black where they end: as many as it allows. Before the
# least number it ends no path by chance, which would be seen as noise.
TRANSPARENT_BOUNCES = 1024
_FACTOR = 2  # the Attribute node's output, "Fac" in 4.5 and "Factor" in 5.2


def make_materials(name: str, made: Made) -> Materials:
    """The three materials; each is kept in `made`."""
    return Materials(
        solid=_emission(name, "INSTANCER", made),
        splat=_splat(f"{name} splat", made),
        points=_emission(f"{name} points", "GEOMETRY", made),
    )


def _emission(name: str, where: str, made: Made) -> Any:
    """Emission in the attribute `colour` of the instance (INSTANCER) or of the mesh itself (GEOMETRY)."""
    material, graph = _new(name, made)
    _finish(graph, _emit(graph, where))
    return material


def _splat(name: str, made: Made) -> Any:
    """What a Gaussian looks like: opacity · exp(−d²/2), d how far, in σ, the view ray passes the centre.

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
