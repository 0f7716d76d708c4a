"""The node tree that moves and draws splats: Scene Time → Σ modes → Set Position → Instance on Points.

Built in code and self-contained: the .blend plays without the extension, sub-frames and farms included.
x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)] (docs/conventions.md); t = (frame − first)·speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy

ALPHA, LOW, HIGH = "Magnification", "Band Low", "Band High"
FIRST, SPEED, SIZE, MIN_OPACITY = "First Frame", "Speed", "Size", "Minimum Opacity"
# name, default, least, most, description
INPUTS = (
    (ALPHA, 0.0, -1.0, 1000.0, "A displacement d becomes (1 + this) d; -1 stops the motion"),
    (LOW, 0.0, 0.0, 1e6, "Lowest frequency that is magnified, Hz"),
    (HIGH, 1e6, 0.0, 1e6, "Highest frequency that is magnified, Hz"),
    (FIRST, 1.0, -1e6, 1e6, "Frame that shows timestep 0"),
    (SPEED, 1.0, -1e3, 1e3, "Timesteps per frame"),
    (SIZE, 1.6, 0.0, 10.0, "Radius of an ellipsoid in standard deviations of its Gaussian"),
    (MIN_OPACITY, 0.1, 0.0, 1.0, "Gaussians less opaque than this are not drawn"),
)
SCALE, ROTATION, COLOUR, OPACITY = "scale", "rotation", "colour", "opacity"
SUBDIVISIONS = 2  # of the icosphere: 80 triangles


def phasor_names(mode: int) -> dict[str, str]:
    """The vector attributes of a mode: real and imaginary part of displacement and rotation vector."""
    return {part: f"mode_{mode}_{part}" for part in ("re", "im", "re_r", "im_r")}


def build_tree(name: str, freqs_hz: Sequence[float], fps: float, material: Any) -> Any:
    """A node group for splats with these modes. `fps` (Hz) matters only where there are modes."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    try:
        _fill(tree, freqs_hz, fps, material)
    except BaseException:
        bpy.data.node_groups.remove(tree)
        raise
    return tree


def _fill(tree: Any, freqs_hz: Sequence[float], fps: float, material: Any) -> None:
    tree.is_modifier = True
    interface = tree.interface
    interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    for name, default, least, most, description in INPUTS:
        socket = interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.default_value, socket.min_value, socket.max_value = default, least, most
        socket.description = description
    graph = _Graph(tree)
    inputs = graph.node("NodeGroupInput").outputs
    offset, turn = _motion(graph, inputs, freqs_hz, fps)
    moved = inputs["Geometry"]
    if offset is not None:
        move = graph.node("GeometryNodeSetPosition")
        graph.link(moved, move.inputs["Geometry"])
        graph.link(offset, move.inputs["Offset"])
        moved = move.outputs["Geometry"]
    drawn = _instances(graph, inputs, moved, turn, material)
    graph.link(drawn, graph.node("NodeGroupOutput").inputs[0])
    graph.arrange()


def _motion(graph: _Graph, inputs: Any, freqs_hz: Sequence[float], fps: float) -> tuple[Any, Any]:
    """The displacement and the rotation vector at the scene's time; (None, None) without modes."""
    if len(freqs_hz) == 0:
        return None, None
    frame = graph.node("GeometryNodeInputSceneTime").outputs["Frame"]
    t = graph.math("MULTIPLY", graph.math("SUBTRACT", frame, inputs[FIRST]), inputs[SPEED])
    offset = turn = None
    for k, f in enumerate(freqs_hz):
        gain = _gain(graph, inputs, float(f))
        angle = graph.math("MULTIPLY", t, 2 * math.pi * float(f) / fps)
        cosine = graph.math("MULTIPLY", graph.math("COSINE", angle), gain)
        sine = graph.math("MULTIPLY", graph.math("SINE", angle), gain)
        names = phasor_names(k)
        offset = _add_wave(graph, offset, names["re"], names["im"], cosine, sine)
        turn = _add_wave(graph, turn, names["re_r"], names["im_r"], cosine, sine)
    return offset, turn


def _gain(graph: _Graph, inputs: Any, f: float) -> Any:
    """1 + α·g, g = 1 for low ≤ f ≤ high, else 0."""
    # The tree computes in float32, in which a band edge typed as 0.1 and a frequency of 0.1 may differ.
    slack = 1e-6 * max(1.0, f)
    above = graph.math("LESS_THAN", inputs[LOW], f + slack)
    below = graph.math("GREATER_THAN", inputs[HIGH], f - slack)
    return graph.math("MULTIPLY_ADD", graph.math("MULTIPLY", above, below), inputs[ALPHA], 1.0)


def _add_wave(graph: _Graph, total: Any, re: str, im: str, cosine: Any, sine: Any) -> Any:
    """total + Re[(re + i·im)(cos + i·sin)] = total + re·cos − im·sin."""
    real = graph.scaled(graph.attribute(re, "FLOAT_VECTOR"), cosine)
    imaginary = graph.scaled(graph.attribute(im, "FLOAT_VECTOR"), sine)
    wave = graph.vector("SUBTRACT", real, imaginary)
    return wave if total is None else graph.vector("ADD", total, wave)


def _instances(graph: _Graph, inputs: Any, points: Any, turn: Any, material: Any) -> Any:
    """An ellipsoid at every point that is opaque enough."""
    sphere = graph.node("GeometryNodeMeshIcoSphere")
    sphere.inputs["Radius"].default_value = 1.0
    sphere.inputs["Subdivisions"].default_value = SUBDIVISIONS
    painted = graph.node("GeometryNodeSetMaterial")
    graph.link(sphere.outputs["Mesh"], painted.inputs["Geometry"])
    painted.inputs["Material"].default_value = material

    enough = graph.node("FunctionNodeCompare")
    enough.data_type, enough.operation = "FLOAT", "GREATER_EQUAL"
    graph.link(graph.attribute(OPACITY, "FLOAT"), enough.inputs[0])
    graph.link(inputs[MIN_OPACITY], enough.inputs[1])

    place = graph.node("GeometryNodeInstanceOnPoints")
    graph.link(points, place.inputs["Points"])
    graph.link(painted.outputs["Geometry"], place.inputs["Instance"])
    graph.link(enough.outputs[0], place.inputs["Selection"])
    graph.link(_rotation(graph, turn), place.inputs["Rotation"])
    graph.link(graph.scaled(graph.attribute(SCALE, "FLOAT_VECTOR"), inputs[SIZE]), place.inputs["Scale"])
    return place.outputs["Instances"]


def _rotation(graph: _Graph, turn: Any) -> Any:
    """exp(turn)·q: the rest rotation, then the rotation vector about the object's axes."""
    rest = graph.attribute(ROTATION, "QUATERNION")
    if turn is None:
        return rest
    length = graph.node("ShaderNodeVectorMath")
    length.operation = "LENGTH"
    graph.link(turn, length.inputs[0])
    turned = graph.node("FunctionNodeAxisAngleToRotation")
    graph.link(turn, turned.inputs["Axis"])  # the node normalises it
    graph.link(length.outputs["Value"], turned.inputs["Angle"])
    both = graph.node("FunctionNodeRotateRotation")
    both.rotation_space = "GLOBAL"
    graph.link(rest, both.inputs["Rotation"])
    graph.link(turned.outputs["Rotation"], both.inputs["Rotate By"])
    return both.outputs["Rotation"]


class _Graph:
    """Short names for making and linking nodes of one tree."""

    def __init__(self, tree: Any) -> None:
        self._tree = tree

    def node(self, kind: str) -> Any:
        return self._tree.nodes.new(kind)

    def link(self, source: Any, target: Any) -> None:
        self._tree.links.new(source, target)

    def math(self, operation: str, *values: Any) -> Any:
        return self._operate("ShaderNodeMath", operation, values)

    def vector(self, operation: str, *values: Any) -> Any:
        return self._operate("ShaderNodeVectorMath", operation, values)

    def scaled(self, vector: Any, factor: Any) -> Any:
        node = self.node("ShaderNodeVectorMath")
        node.operation = "SCALE"
        self.link(vector, node.inputs["Vector"])
        self.link(factor, node.inputs["Scale"])
        return node.outputs["Vector"]

    def attribute(self, name: str, data_type: str) -> Any:
        node = self.node("GeometryNodeInputNamedAttribute")
        node.data_type = data_type
        node.inputs["Name"].default_value = name
        return next(out for out in node.outputs if out.enabled and out.name == "Attribute")

    def arrange(self, column: int = 180, row: int = 160, rows: int = 8) -> None:
        """Lay the nodes out in columns, in the order they were made, so that the tree can be looked at."""
        for i, node in enumerate(self._tree.nodes):
            node.location = (i // rows) * column, -(i % rows) * row

    def _operate(self, kind: str, operation: str, values: Sequence[Any]) -> Any:
        node = self.node(kind)
        node.operation = operation
        for value, socket in zip(values, node.inputs, strict=False):
            if isinstance(value, int | float):
                socket.default_value = value
            else:
                self.link(value, socket)
        return node.outputs[0]
