"""The node groups "Motion" (displacement, rotation, amplitude, phase of each point) and "Sequence" (a file per frame).

x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)] (docs/conventions.md);
t = (frame − first)·speed·fps / (the scene's own rate). A mode that is not shown contributes nothing.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import bpy

from .. import names
from .graph import Graph, Made

AT_ONCE = 8  # modes in a group
# Sums over the modes so far, or their largest: Most is an amplitude, Phase that mode's.
_SUMS = (
    ("Offset", "Vector"),
    ("Turn", "Vector"),
    ("Squares", "Float"),
    ("Most", "Float"),
    ("Phase", "Float"),
)
SLACK = 1e-3  # timesteps; a time that float32 puts just before a whole one is that one


class MotionSockets(NamedTuple):
    """Fields over the points, as sockets of the tree that uses the group."""

    offset: Any  # scene units
    turn: Any  # rotation vector, radians, object axes
    amplitude: Any  # scene units, of the shown modes inside the band, not magnified
    phase: Any  # turns, of the largest of these modes


def build_motion(name: str, freqs_hz: Sequence[float], fps: float, made: Made) -> Any:
    """A node group for modes of these frequencies (at least one), timesteps at `fps` Hz; kept in `made`."""
    mode = made.keep(_build_mode(name))
    graph = Graph(made.keep(bpy.data.node_groups.new(f"{name} Motion", "GeometryNodeTree")))
    for socket in (names.ALPHA, names.LOW, names.HIGH, names.FIRST, names.SPEED):
        graph.interface(socket, "Float")
    shown = names.toggles(freqs_hz)
    for socket in shown:
        graph.interface(socket, "Bool", True)
    for socket, kind in (*_SUMS[:2], ("Amplitude", "Float"), _SUMS[-1]):
        graph.result(socket, kind)
    inputs = graph.inputs()
    total: dict[str, Any] = {"Time": elapsed(graph, inputs, fps)}
    for socket in (names.ALPHA, names.LOW, names.HIGH):
        total[socket] = inputs[socket]
    total[names.ALPHA] = graph.finite(inputs[names.ALPHA])
    for first in range(0, len(shown), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        part = made.keep(_build_modes(name, mode, first, freqs_hz[some], shown[some], fps))
        outputs = graph.group(part, **total, **{socket: inputs[socket] for socket in shown[some]})
        total.update({sum_: outputs[sum_] for sum_, _ in _SUMS})
    amplitude = graph.math("SQRT", total["Squares"])
    graph.finish(Offset=total["Offset"], Turn=total["Turn"], Amplitude=amplitude, Phase=total["Phase"])
    return graph.tree


def _build_modes(
    name: str, mode: Any, first: int, freqs_hz: Sequence[float], shown: Sequence[str], fps: float
) -> Any:
    """A node group that adds some modes, from number `first` on, to the sums over the modes before.

    Blender's time for each change of a tree grows with the tree, so a tree for all modes takes their number squared.
    """
    graph = Graph(bpy.data.node_groups.new(f"{name} Modes {first + 1}", "GeometryNodeTree"))
    passed = ("Time", names.ALPHA, names.LOW, names.HIGH)
    for socket in passed:
        graph.interface(socket, "Float")
    for socket in shown:
        graph.interface(socket, "Bool", True)
    for socket, kind in _SUMS:
        graph.interface(socket, kind)
        graph.result(socket, kind)
    inputs = graph.inputs()
    total = {socket: inputs[socket] for socket in (*passed, *(sum_ for sum_, _ in _SUMS))}
    for k, (f, socket) in enumerate(zip(freqs_hz, shown, strict=True), start=first):
        # The tree computes in float32, in which a band edge typed as 0.1 and a frequency of 0.1 may differ.
        slack = 1e-6 * max(1.0, f)
        numbers = {"Above": f + slack, "Below": f - slack, "Angle": 2 * math.pi * float(f) / fps}
        attributes = {**names.phasor(k), "amplitude": names.amplitude(k), "phase": names.phase(k)}
        outputs = graph.group(mode, **total, **numbers, **attributes, Shown=inputs[socket])
        total.update({sum_: outputs[sum_] for sum_, _ in _SUMS})
    graph.finish(**{sum_: total[sum_] for sum_, _ in _SUMS})
    return graph.tree


def _build_mode(name: str) -> Any:
    """A node group that adds one mode to the sums over the modes before; all modes share it."""
    graph = Graph(bpy.data.node_groups.new(f"{name} Mode", "GeometryNodeTree"))
    for socket in (*(part.replace("_", " ") for part in names.phasor(0)), "amplitude", "phase"):
        graph.interface(socket, "String")  # names of attributes
    for socket in ("Time", names.ALPHA, names.LOW, names.HIGH, "Above", "Below", "Angle"):
        graph.interface(socket, "Float")
    graph.interface("Shown", "Bool", True)
    for socket, kind in _SUMS:
        graph.interface(socket, kind)
        graph.result(socket, kind)
    inputs = graph.inputs()
    flag = graph.math("MULTIPLY", _inside(graph, inputs), inputs["Shown"])
    gain = graph.math("MULTIPLY_ADD", flag, inputs[names.ALPHA], inputs["Shown"])
    angle = graph.math("MULTIPLY", inputs["Time"], inputs["Angle"])
    cosine = graph.math("MULTIPLY", graph.math("COSINE", angle), gain)
    sine = graph.math("MULTIPLY", graph.math("SINE", angle), graph.math("MULTIPLY", gain, -1.0))
    wave = [graph.call("ShaderNodeCombineXYZ", dict.fromkeys("XYZ", part)) for part in (cosine, sine)]
    a = graph.math("MULTIPLY", graph.attribute(inputs["amplitude"], "FLOAT"), flag)
    larger = graph.compare("GREATER_THAN", a, inputs["Most"])
    phase = graph.attribute(inputs["phase"], "FLOAT")
    graph.finish(
        Offset=_add_wave(graph, inputs["Offset"], inputs["re"], inputs["im"], wave),
        Turn=_add_wave(graph, inputs["Turn"], inputs["re r"], inputs["im r"], wave),
        Squares=graph.math("MULTIPLY_ADD", a, a, inputs["Squares"]),
        Most=graph.math("MAXIMUM", a, inputs["Most"]),
        Phase=graph.choose("FLOAT", larger, inputs["Phase"], phase),
    )
    return graph.tree


def use_motion(graph: Graph, tree: Any, inputs: Any) -> MotionSockets:
    """Add a node of the group, linked to the inputs of the same names."""
    node = graph.node("GeometryNodeGroup", node_tree=tree)
    for socket in node.inputs:
        graph.put(inputs[socket.name], socket)
    return MotionSockets(*(node.outputs[name] for name in ("Offset", "Turn", "Amplitude", "Phase")))


def elapsed(graph: Graph, inputs: Any, fps: float) -> Any:
    """Timesteps since the first frame, fractions included.

    At a speed of 1 the recording, `fps` timesteps a second, takes as long as it took, whatever the scene's frame
    rate. A recording of unknown rate (`fps` 0) has a timestep in each frame.
    """
    now = graph.node("GeometryNodeInputSceneTime").outputs
    first, speed = graph.finite(inputs[names.FIRST]), graph.finite(inputs[names.SPEED])
    frames = graph.math("MULTIPLY", graph.math("SUBTRACT", now["Frame"], first), speed)
    if not fps:
        return frames
    # Frame 0 is at 0 seconds and does not tell the rate.
    unknown = graph.compare("EQUAL", now["Frame"], 0.0)
    per_frame = graph.choose("FLOAT", unknown, graph.math("DIVIDE", now["Seconds"], now["Frame"]), 1.0 / fps)
    return graph.math("MULTIPLY", frames, graph.math("MULTIPLY", per_frame, fps))


def _inside(graph: Graph, inputs: Any) -> Any:
    above = graph.math("LESS_THAN", inputs[names.LOW], inputs["Above"])
    below = graph.math("GREATER_THAN", inputs[names.HIGH], inputs["Below"])
    return graph.math("MULTIPLY", above, below)


def _add_wave(graph: Graph, total: Any, re: Any, im: Any, wave: Sequence[Any]) -> Any:
    """total + Re[(re + i·im)(cos + i·sin)] = total + re·cos − im·sin; re and im are names of attributes.

    `wave`: the vectors (cos, cos, cos) and −(sin, sin, sin). Each step reads and writes all points, so few steps count.
    """
    for part, factor in zip((re, im), wave, strict=True):
        total = graph.vector("MULTIPLY_ADD", graph.attribute(part, "FLOAT_VECTOR"), factor, total)
    return total


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
