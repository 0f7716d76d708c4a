"""The group "Shapes": what is drawn at each point: an ellipsoid, a splat, a dot or an arrow.

Reads the attributes scale, rotation, opacity and, for arrows, displacement.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy

from .. import compat, names
from .graph import Graph

SUBDIVISIONS = 2  # of the icosphere: 80 triangles
FEWEST_SUBDIVISIONS = 1  # 20 triangles
SPLAT_RADIUS = 3.0  # standard deviations; the material's fall-off is made for it
NO_ARROW = 1e-9  # scene units; a shorter displacement has no direction


class Materials(NamedTuple):
    """What the shapes are painted with."""

    solid: Any  # emission in the colour of the instance
    splat: Any  # the same, fading out like a Gaussian
    points: Any  # emission in the colour of the point itself


def build_shapes(name: str, materials: Materials) -> Any:
    """A node group: points to what is drawn of them."""
    graph = Graph(bpy.data.node_groups.new(f"{name} Shapes", "GeometryNodeTree"))
    graph.interface("Points", "Geometry")
    graph.interface(names.DRAW, "Int")
    for socket in (
        names.SIZE,
        names.RADIUS,
        names.MIN_OPACITY,
        names.MIN_SPLAT_OPACITY,
        names.ARROW_LENGTH,
        "Growth",
    ):
        graph.interface(socket, "Float")
    graph.interface(names.ARROW_EVERY, "Int", 1)
    graph.interface(names.SOLID_COLOUR, "Bool")
    graph.result("Geometry", "Geometry")
    inputs = graph.inputs()
    points = inputs["Points"]
    opacity = graph.attribute(names.OPACITY, "FLOAT")
    enough = graph.compare("GREATER_EQUAL", opacity, inputs[names.MIN_OPACITY])
    # What is see-through adds up, so splats need the faint ones too.
    faint = graph.compare("GREATER_EQUAL", opacity, inputs[names.MIN_SPLAT_OPACITY])
    radius = graph.math("MULTIPLY", inputs[names.SIZE], inputs[names.RADIUS])
    splat_radius = graph.math("MULTIPLY", inputs[names.SIZE], SPLAT_RADIUS)
    solid = graph.choose("MATERIAL", inputs[names.SOLID_COLOUR], materials.solid, materials.points)
    kinds = [
        _balls(graph, points, enough, radius, solid),
        _balls(graph, points, faint, splat_radius, materials.splat),
        _dots(
            graph, points, enough, (radius, inputs["Growth"]), materials.points, inputs[names.SOLID_COLOUR]
        ),
        _arrows(graph, points, enough, inputs, solid),
    ]
    if compat.native_splats():
        kinds.append(_native(graph, points, inputs[names.SIZE]))
    drawn = graph.pick("GEOMETRY", inputs[names.DRAW], *kinds)
    flat = _realized(graph, points, drawn)
    graph.finish(Geometry=graph.choose("GEOMETRY", inputs[names.SOLID_COLOUR], drawn, flat))
    return graph.tree


def _balls(graph: Graph, points: Any, selection: Any, radius: Any, material: Any) -> Any:
    """An ellipsoid at every selected point; `radius` in standard deviations."""
    sphere = graph.call("GeometryNodeMeshIcoSphere", {"Radius": 1.0, "Subdivisions": SUBDIVISIONS}, "Mesh")
    inputs = {
        "Points": points,
        "Instance": graph.painted(sphere, material),
        "Selection": selection,
        "Rotation": graph.attribute(names.ROTATION, "QUATERNION"),
        "Scale": graph.scaled(graph.attribute(names.SCALE, "FLOAT_VECTOR"), radius),
    }
    return graph.call("GeometryNodeInstanceOnPoints", inputs)


def _dots(
    graph: Graph, points: Any, selection: Any, radius: tuple[Any, Any], material: Any, solid: Any
) -> Any:
    """Round dots of the Gaussians' mean size, `radius` in deviations: a point cloud, the quickest to draw.

    Solid view shows point clouds white, so for it they are small balls. The second `radius` is a factor for dots alone,
    which Transform Geometry leaves as large as they are.
    """
    size = graph.vector("MULTIPLY", graph.attribute(names.SCALE, "FLOAT_VECTOR"), (1 / 3, 1 / 3, 1 / 3))
    x, y, z = graph.split(size)
    mean = graph.math("MULTIPLY", graph.math("ADD", graph.math("ADD", x, y), z), radius[0])
    size = graph.math("MULTIPLY", mean, radius[1])
    cloud = graph.call("GeometryNodeMeshToPoints", {"Mesh": points, "Selection": selection, "Radius": size})
    sphere = graph.call(
        "GeometryNodeMeshIcoSphere", {"Radius": 1.0, "Subdivisions": FEWEST_SUBDIVISIONS}, "Mesh"
    )
    balls = graph.call(
        "GeometryNodeInstanceOnPoints",
        {
            "Points": points,
            "Instance": sphere,
            "Selection": selection,
            "Scale": graph.scaled((1.0, 1.0, 1.0), mean),
        },
    )
    return graph.choose("GEOMETRY", solid, graph.painted(cloud, material), graph.painted(balls, material))


def _native(graph: Graph, points: Any, size: Any) -> Any:
    """A point cloud of Blender's own splats; their attributes are on the points already (points.py)."""
    scales = graph.scaled(graph.attribute(names.SCALE, "FLOAT_VECTOR"), size)
    sized = graph.store(points, names.SCALE, "FLOAT_VECTOR", scales)
    points = graph.choose("GEOMETRY", graph.compare("EQUAL", size, 1.0), sized, points)
    cloud = graph.call("GeometryNodeMeshToPoints", {"Mesh": points})
    node = graph.node("GeometryNodePointsSetType")
    compat.choose_splats(node)
    graph.put(cloud, node.inputs[0])
    return node.outputs[0]


def _gaussians(graph: Graph, points: Any) -> Any:
    """The points without the references for Apply Transform, whose opacity is below 0 (points.py)."""
    real = graph.compare("GREATER_EQUAL", graph.attribute(names.OPACITY, "FLOAT"), 0.0)
    return graph.call("GeometryNodeSeparateGeometry", {"Geometry": points, "Selection": real}, domain="POINT")


def _arrows(graph: Graph, points: Any, selection: Any, inputs: Any, material: Any) -> Any:
    """At every n-th point an arrow along its displacement, as long as it times the input's factor."""
    shift = graph.attribute(names.DISPLACEMENT, "FLOAT_VECTOR")
    length = graph.length(shift)
    index = graph.node("GeometryNodeInputIndex").outputs[0]
    remainder = graph.math("FLOORED_MODULO", index, graph.math("MAXIMUM", inputs[names.ARROW_EVERY], 1))
    chosen = graph.both(
        selection, graph.compare("GREATER_THAN", length, NO_ARROW), graph.compare("LESS_THAN", remainder, 0.5)
    )
    place = {
        "Points": points,
        "Instance": graph.painted(_arrow(graph), material),
        "Selection": chosen,
        "Rotation": graph.call("FunctionNodeAlignRotationToVector", {"Vector": shift}, axis="Z"),
        "Scale": graph.scaled((1.0, 1.0, 1.0), graph.math("MULTIPLY", length, inputs[names.ARROW_LENGTH])),
    }
    return graph.call("GeometryNodeInstanceOnPoints", place)


def _arrow(graph: Graph) -> Any:
    """A mesh of length 1 along z, from the origin."""
    shaft = {"Vertices": 8, "Radius": 0.035, "Depth": 0.7}
    head = {"Vertices": 12, "Radius Top": 0.0, "Radius Bottom": 0.1, "Depth": 0.3}
    joined = graph.node("GeometryNodeJoinGeometry")
    # A cylinder's origin is its middle, a cone's its base.
    for kind, sizes, z in (("Cylinder", shaft, 0.35), ("Cone", head, 0.7)):
        mesh = graph.call(f"GeometryNodeMesh{kind}", sizes, "Mesh")
        moved = graph.call("GeometryNodeTransform", {"Geometry": mesh, "Translation": (0.0, 0.0, z)})
        graph.put(moved, joined.inputs[0])
    return joined.outputs[0]


def _realized(graph: Graph, points: Any, drawn: Any) -> Any:
    """One mesh with the points' colours, which Solid view can show: it colours no instances.

    Realising loses which colour attribute is the active one; joining with the points' own mesh, whose loose
    vertices nothing draws, brings that back.
    """
    joined = graph.node("GeometryNodeJoinGeometry")
    graph.put(graph.call("GeometryNodeRealizeInstances", {"Geometry": drawn}), joined.inputs[0])
    graph.put(_gaussians(graph, points), joined.inputs[0])
    return joined.outputs[0]
