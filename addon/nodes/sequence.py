"""The group "Sequence": the points of the frame whose turn it is, out of a collection of objects."""

from __future__ import annotations

from typing import Any

import bpy

from .. import names
from .graph import Graph
from .motion import elapsed

SLACK = 1e-3  # timesteps; a time that float32 puts just before a whole one is that one


def build_sequence(name: str, collection: Any, count: int) -> Any:
    """A node group: the points of the collection's object number floor(t), by their names' order.

    Before the first and after the last the nearest is shown, or with `Loop` the run starts again.
    """
    graph = Graph(bpy.data.node_groups.new(f"{name} Sequence", "GeometryNodeTree"))
    for socket in (names.FIRST, names.SPEED):
        graph.interface(socket, "Float")
    graph.interface(names.LOOP, "Bool")
    graph.result("Points", "Geometry")
    inputs = graph.inputs()
    t = graph.math("FLOOR", graph.math("ADD", elapsed(graph, inputs, 0.0), SLACK))
    held = graph.math("MINIMUM", graph.math("MAXIMUM", t, 0.0), float(count - 1))
    now = graph.choose("FLOAT", inputs[names.LOOP], held, graph.math("FLOORED_MODULO", t, float(count)))
    options = {"Collection": collection, "Separate Children": True, "Reset Children": True}
    frames = graph.call("GeometryNodeCollectionInfo", options)
    index = graph.node("GeometryNodeInputIndex").outputs[0]
    near = graph.compare("LESS_THAN", graph.math("ABSOLUTE", graph.math("SUBTRACT", index, now)), 0.5)
    shown = {"Geometry": frames, "Selection": near}
    one = graph.call("GeometryNodeSeparateGeometry", shown, domain="INSTANCE")
    graph.finish(Points=graph.call("GeometryNodeRealizeInstances", {"Geometry": one}))
    return graph.tree
