"""Colours of the file and of the two colour maps in linear light, as numbers and as node groups."""

from typing import Any

import bpy
import numpy as np

from tg4mm.core.colour import MOVES_ABOVE, STILL, STILL_BELOW, amount_colours, phase_colours, to_linear

from .. import names
from .graph import Graph

C0 = 0.28209479177387814  # Y_00, the constant spherical harmonic: 1 / (2 √π)
IN_CACHE = 8192  # Gaussians at a time
STEPS = 24  # of a colour map: a Color Ramp has at most 32 colours


def rest_colours(sh: np.ndarray) -> np.ndarray:
    """[N, 4] float32 linear RGBA of sh [N, K, 3]: the part that does not depend on the view.

    Spherical harmonics of [3DGS] give display-referred sRGB, 0.5 + C0·sh_0; emission needs linear light.
    """
    rgba = np.empty((len(sh), 4), np.float32)
    rgba[:, 3] = 1
    for start in range(0, len(sh), IN_CACHE):
        rows = slice(start, start + IN_CACHE)
        rgba[rows, :3] = to_linear(np.float32(0.5) + np.float32(C0) * sh[rows, 0])
    return rgba


def amplitude_map() -> np.ndarray:
    """[STEPS + 1, 3] linear RGB of equal steps from 0 to the largest amplitude: the report's map for amounts."""
    return to_linear(amount_colours(np.linspace(0.0, 1.0, STEPS + 1)))


def phase_map() -> np.ndarray:
    """[STEPS + 1, 3] linear RGB of equal steps from 0 to one turn, first and last alike: the report's for phases."""
    return to_linear(phase_colours(2 * np.pi * np.arange(STEPS + 1) / STEPS))


def phase_and_still() -> np.ndarray:
    """[STEPS + 2, 3] the map for phases, then the grey of what hardly moves."""
    return np.vstack([phase_map(), np.full((1, 3), still())])


def still() -> float:
    """Return the linear grey of points that move too little to have a phase."""
    return float(to_linear(np.array(STILL)))


def build_colour_map(name: str) -> Any:
    """Build a node group that maps amplitude (scene units) or phase (turns) to a linear colour."""
    graph = Graph(bpy.data.node_groups.new(f"{name} Colour Map", "GeometryNodeTree"))
    for socket in ("Amplitude", "Phase", names.COLOUR_RANGE):
        graph.interface(socket, "Float")
    graph.interface("By Phase", "Bool")
    graph.result("Colour", "Color")
    inputs = graph.inputs()
    part = graph.math("DIVIDE", inputs["Amplitude"], inputs[names.COLOUR_RANGE])
    by_amplitude = _ramp(graph, part, amplitude_map())
    # Blender's FRACT is x − floor(x), so phases outside 0..1 are fine.
    hue = _ramp(graph, graph.math("FRACT", inputs["Phase"]), phase_map())
    above = graph.math("SUBTRACT", part, STILL_BELOW)
    share = graph.math("DIVIDE", above, MOVES_ABOVE - STILL_BELOW)  # the node limits it to 0..1
    by_phase = graph.call(
        "ShaderNodeMix", {"Factor": share, "A": (*[still()] * 3, 1.0), "B": hue}, data_type="RGBA"
    )
    graph.finish(Colour=graph.choose("RGBA", inputs["By Phase"], by_amplitude, by_phase))
    return graph.tree


def build_harmonics(name: str, degree: int) -> Any:
    """Build a node group for the view-dependent linear colour of each point; degree 1 to 3.

    max(0, 0.5 + Σ_k sh_k·Y_k(d)) as in docs/conventions.md, d from the place to the point, both of the object at rest.
    """
    graph = Graph(bpy.data.node_groups.new(f"{name} Harmonics", "GeometryNodeTree"))
    graph.interface("Camera", "Vector")
    graph.result("Colour", "Color")
    here = graph.node("GeometryNodeInputPosition").outputs[0]
    toward = graph.vector("NORMALIZE", graph.vector("SUBTRACT", here, graph.inputs()["Camera"]))
    total = graph.scaled(graph.attribute(names.NATIVE_BASE, "FLOAT_COLOR"), C0)
    for k, y in enumerate(_basis(graph, toward, degree), start=1):
        coefficient = graph.attribute(names.native_sh(k), "FLOAT_VECTOR")
        total = graph.vector("ADD", total, graph.scaled(coefficient, y))
    srgb = graph.vector("ADD", total, (0.5, 0.5, 0.5))
    channels = [_linear(graph, channel) for channel in graph.split(srgb)]
    colour = graph.call(
        "FunctionNodeCombineColor", dict(zip(("Red", "Green", "Blue"), channels, strict=True))
    )
    graph.finish(Colour=colour)
    return graph.tree


def camera_place(graph: Graph) -> Any:
    """Return the scene camera's position in object axes."""
    camera = graph.node("GeometryNodeInputActiveCamera").outputs[0]
    return graph.call("GeometryNodeObjectInfo", {"Object": camera}, "Location", transform_space="RELATIVE")


def _basis(graph: Graph, direction: Any, degree: int) -> list[Any]:
    """Y_1 … Y_K-1 of docs/conventions.md at a unit vector."""
    x, y, z = graph.split(direction)

    def times(a: Any, b: Any) -> Any:
        return graph.math("MULTIPLY", a, b)

    def plus(a: Any, factor: float, b: Any) -> Any:
        return graph.math("MULTIPLY_ADD", b, factor, a)

    basis = [times(y, -0.4886025119029199), times(z, 0.4886025119029199), times(x, -0.4886025119029199)]
    if degree == 1:
        return basis
    xx, yy, zz, xy, yz, xz = times(x, x), times(y, y), times(z, z), times(x, y), times(y, z), times(x, z)
    difference = plus(xx, -1.0, yy)
    basis += [
        times(xy, 1.0925484305920792),
        times(yz, -1.0925484305920792),
        plus(-0.31539156525252005, 3 * 0.31539156525252005, zz),  # x² + y² = 1 − z²
        times(xz, -1.0925484305920792),
        times(difference, 0.5462742152960396),
    ]
    if degree == 2:
        return basis
    ring = plus(-1.0, 5.0, zz)  # 4z² − x² − y²
    return [
        *basis,
        times(times(y, plus(times(xx, 3.0), -1.0, yy)), -0.5900435899266435),
        times(times(xy, z), 2.890611442640554),
        times(times(y, ring), -0.4570457994644658),
        times(times(z, plus(-3.0, 5.0, zz)), 0.3731763325901154),  # 2z² − 3x² − 3y²
        times(times(x, ring), -0.4570457994644658),
        times(times(z, difference), 1.445305721320277),
        times(times(x, plus(xx, -3.0, yy)), -0.5900435899266435),
    ]


def _linear(graph: Graph, value: Any) -> Any:
    """Convert one sRGB channel, clamped to 0..1, to linear light."""
    clamped = graph.math("MINIMUM", graph.math("MAXIMUM", value, 0.0), 1.0)
    low = graph.math("DIVIDE", clamped, 12.92)
    high = graph.math("POWER", graph.math("MULTIPLY_ADD", clamped, 1 / 1.055, 0.055 / 1.055), 2.4)
    return graph.choose("FLOAT", graph.compare("LESS_EQUAL", clamped, 0.04045), high, low)


def build_encoded(name: str) -> Any:
    """Build a node group that converts linear light in 0..1 to display-referred sRGB."""
    graph = Graph(bpy.data.node_groups.new(f"{name} Encoded", "GeometryNodeTree"))
    graph.interface("Colour", "Color")
    graph.result("Colour", "Color")
    parts = graph.node("FunctionNodeSeparateColor")
    graph.put(graph.inputs()["Colour"], parts.inputs[0])
    channels = []
    for value in list(parts.outputs)[:3]:
        high = graph.math("MULTIPLY_ADD", graph.math("POWER", value, 1 / 2.4), 1.055, -0.055)
        is_low = graph.compare("LESS_EQUAL", value, 0.0031308)
        channels.append(graph.choose("FLOAT", is_low, high, graph.math("MULTIPLY", value, 12.92)))
    named = dict(zip(("Red", "Green", "Blue"), channels, strict=True))
    graph.finish(Colour=graph.call("FunctionNodeCombineColor", named))
    return graph.tree


def _ramp(graph: Graph, factor: Any, rows: np.ndarray) -> Any:
    """Interpolate linear RGB rows at equal steps from 0 to 1."""
    node = graph.node("ShaderNodeValToRGB")
    elements = node.color_ramp.elements
    for i, row in enumerate(rows):
        place = i / (len(rows) - 1)
        element = elements[i] if i < 1 else elements.new(place) if i < len(rows) - 1 else elements[-1]
        element.position, element.color = place, (*row, 1.0)
    graph.put(factor, node.inputs[0])
    return node.outputs["Color"]
