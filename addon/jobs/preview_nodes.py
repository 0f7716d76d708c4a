"""The node tree of the preview: moves a mesh by displacements that a helper object carries, times their gains.

The modifier stands last, so that it sees the vertices that the displacements were computed for; the mesh
itself is left alone, whatever modifiers it has and however many objects share it. A displacement is
Σ basis_g(x) · gain_g(t) (dataset_gen/vibration/motion.py), t = frame − first frame of the scene.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import bpy

from ..generator.dataset_gen.vibration import Motion, Vibration
from ..generator.dataset_gen.vibration.motion import Basis
from ..nodes.graph import Graph

HELPER = "Displacements"  # the modifier's input
GAIN = "tg4mm gain"  # the node that holds it


def attribute(number: int) -> str:
    """Vector attribute of the helper: basis shape `number`, the object's own axes."""
    return f"basis_{number}"


def build_tree(name: str, motion: Motion, gain: float, first_frame: int) -> Any:
    """A node tree for the basis shapes of a motion."""
    graph = Graph(bpy.data.node_groups.new(name, "GeometryNodeTree"))
    graph.tree.is_modifier = True
    graph.interface("Geometry", "Geometry")
    graph.interface(HELPER, "Object")
    graph.result("Geometry", "Geometry")
    inputs = graph.inputs()
    helper = graph.call("GeometryNodeObjectInfo", {"Object": inputs[HELPER]}, "Geometry")
    index = graph.node("GeometryNodeInputIndex").outputs[0]
    frame = graph.node("GeometryNodeInputSceneTime").outputs["Frame"]
    t = graph.math("SUBTRACT", frame, float(first_frame))
    total: Any = None
    for number, basis in enumerate(motion.bases):
        shape = graph.attribute(attribute(number), "FLOAT_VECTOR")
        taken = {"Geometry": helper, "Value": shape, "Index": index}
        vector = graph.call("GeometryNodeSampleIndex", taken, data_type="FLOAT_VECTOR", domain="POINT")
        part = graph.scaled(vector, _gain(graph, motion, basis, t))
        total = part if total is None else graph.vector("ADD", total, part)
    node = graph.node("ShaderNodeValue", name=GAIN)
    node.outputs[0].default_value = gain
    offset = graph.scaled(total, node.outputs[0])
    moved = graph.call("GeometryNodeSetPosition", {"Geometry": inputs["Geometry"], "Offset": offset})
    graph.finish(Geometry=moved)
    return graph.tree


def _gain(graph: Graph, motion: Motion, basis: Basis, t: Any) -> Any:
    """The gain of a basis shape at timestep t."""
    law, turn = motion.laws[basis.mode], cmath.phase(basis.turn)
    if not isinstance(law, Vibration):  # a ramp, i t / fps
        slope = 1j * basis.turn / motion.fps
        return graph.math("MULTIPLY", t, slope.imag if basis.quadrature else slope.real)
    # Whole turns are taken off before the angle: the tree computes in float32.
    turns = graph.math("FRACT", graph.math("MULTIPLY", t, law.frequency_hz / motion.fps))
    angle = graph.math("MULTIPLY_ADD", turns, 2.0 * math.pi, turn)
    wave = graph.math("SINE" if basis.quadrature else "COSINE", angle)
    if law.decay_s is None:
        return wave
    fall = graph.math("EXPONENT", graph.math("MULTIPLY", t, -1.0 / (motion.fps * law.decay_s)))
    return graph.math("MULTIPLY", wave, fall)
