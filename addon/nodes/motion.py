"""The group "Motion": displacement and turn of each point now, its amplitude and its phase.

x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)] (docs/conventions.md); t = (frame − first)·speed.
A mode that is not shown contributes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import bpy

from .. import names
from .graph import Graph


class Motion(NamedTuple):
    """Fields over the points; sockets of the tree that the group is used in."""

    offset: Any  # scene units
    turn: Any  # rotation vector, radians, object axes
    amplitude: Any  # scene units, of the shown modes inside the band, not magnified
    phase: Any  # turns, of the largest of these modes


def build_motion(name: str, freqs_hz: Sequence[float], fps: float) -> Any:
    """A node group for modes of these frequencies (at least one), timesteps at `fps` Hz."""
    graph = Graph(bpy.data.node_groups.new(f"{name} Motion", "GeometryNodeTree"))
    for socket in (names.ALPHA, names.LOW, names.HIGH, names.FIRST, names.SPEED):
        graph.interface(socket, "Float")
    shown = names.toggles(freqs_hz)
    for socket in shown:
        graph.interface(socket, "Bool", True)
    for socket, kind in (
        ("Offset", "Vector"),
        ("Turn", "Vector"),
        ("Amplitude", "Float"),
        ("Phase", "Float"),
    ):
        graph.result(socket, kind)
    inputs = graph.inputs()
    t = elapsed(graph, inputs)
    flags = []
    offset = turn = None
    for k, (f, socket) in enumerate(zip(freqs_hz, shown, strict=True)):
        flags.append(graph.math("MULTIPLY", _inside(graph, inputs, f), inputs[socket]))
        gain = graph.math("MULTIPLY_ADD", flags[k], inputs[names.ALPHA], inputs[socket])
        angle = graph.math("MULTIPLY", t, 2 * math.pi * float(f) / fps)
        cosine = graph.math("MULTIPLY", graph.math("COSINE", angle), gain)
        sine = graph.math("MULTIPLY", graph.math("SINE", angle), gain)
        part = names.phasor(k)
        offset = _add_wave(graph, offset, part["re"], part["im"], cosine, sine)
        turn = _add_wave(graph, turn, part["re_r"], part["im_r"], cosine, sine)
    amplitude, phase = _strength(graph, flags)
    graph.finish(Offset=offset, Turn=turn, Amplitude=amplitude, Phase=phase)
    return graph.tree


def use_motion(graph: Graph, tree: Any, inputs: Any) -> Motion:
    """A node of the group, its inputs taken from those of the same names."""
    node = graph.node("GeometryNodeGroup", node_tree=tree)
    for socket in node.inputs:
        graph.put(inputs[socket.name], socket)
    return Motion(*(node.outputs[name] for name in ("Offset", "Turn", "Amplitude", "Phase")))


def elapsed(graph: Graph, inputs: Any) -> Any:
    """Timesteps since the first frame, fractions included."""
    frame = graph.node("GeometryNodeInputSceneTime").outputs["Frame"]
    return graph.math("MULTIPLY", graph.math("SUBTRACT", frame, inputs[names.FIRST]), inputs[names.SPEED])


def _inside(graph: Graph, inputs: Any, f: float) -> Any:
    """1 for low ≤ f ≤ high, else 0."""
    # The tree computes in float32, in which a band edge typed as 0.1 and a frequency of 0.1 may differ.
    slack = 1e-6 * max(1.0, f)
    above = graph.math("LESS_THAN", inputs[names.LOW], f + slack)
    below = graph.math("GREATER_THAN", inputs[names.HIGH], f - slack)
    return graph.math("MULTIPLY", above, below)


def _add_wave(graph: Graph, total: Any, re: str, im: str, cosine: Any, sine: Any) -> Any:
    """total + Re[(re + i·im)(cos + i·sin)] = total + re·cos − im·sin."""
    real = graph.scaled(graph.attribute(re, "FLOAT_VECTOR"), cosine)
    imaginary = graph.scaled(graph.attribute(im, "FLOAT_VECTOR"), sine)
    wave = graph.vector("SUBTRACT", real, imaginary)
    return wave if total is None else graph.vector("ADD", total, wave)


def _strength(graph: Graph, flags: Sequence[Any]) -> tuple[Any, Any]:
    """√Σ a_k² over the modes whose flag is 1, and the phase of the one with the largest a_k."""
    squares = most = phase = None
    for k, flag in enumerate(flags):
        a = graph.math("MULTIPLY", graph.attribute(names.amplitude(k), "FLOAT"), flag)
        p = graph.attribute(names.phase(k), "FLOAT")
        square = graph.math("MULTIPLY", a, a)
        if most is None:
            squares, most, phase = square, a, p
            continue
        squares = graph.math("ADD", squares, square)
        phase = graph.choose("FLOAT", graph.compare("GREATER_THAN", a, most), phase, p)
        most = graph.math("MAXIMUM", a, most)
    return graph.math("SQRT", squares), phase
