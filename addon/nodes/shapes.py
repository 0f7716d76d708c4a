"""The node group "Shapes": draws an ellipsoid, splat, dot or arrow at each point."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import bpy

from .. import compat, names
from .graph import Graph

SUBDIVISIONS = 2  # of the icosphere: 80 triangles
FEWEST_SUBDIVISIONS = 1  # 20 triangles
AROUND = 1.2584  # radius of the icosahedron of 20 triangles around a sphere of radius 1
SPLAT_RADIUS = 3.0  # standard deviations; the material's fall-off is made for it
NO_ARROW = 1e-9  # scene units; a shorter displacement has no direction
USUAL, AS_TRAINED = "Ellipsoids", "Splats"  # of a new modifier, which is one mesh's too; by Exact Look


class Materials(NamedTuple):
    """The materials of the shapes."""

    solid: Any  # emission in the colour of the instance
    splat: Any  # the same, fading out like a Gaussian
    points: Any  # emission in the colour of the point itself


@dataclass(frozen=True)
class _Asked:
    graph: Graph
    points: Any
    inputs: Any  # the tree's, by name
    solid: Any  # the material of one mesh: of instances, or in Solid view of the mesh itself
    materials: Materials

    def opaque(self, least: str) -> Any:
        """Return a field that is true where the opacity reaches the given input."""
        opacity = self.graph.attribute(names.OPACITY, "FLOAT")
        return self.graph.compare("GREATER_EQUAL", opacity, self.inputs[least])

    def size(self, deviations: Any) -> Any:
        """Return the radius in standard deviations, times the input Size."""
        return self.graph.math("MULTIPLY", self.inputs[names.SIZE], deviations)


@dataclass(frozen=True)
class DrawMode:
    """A draw mode: an item of the menu Draw As, and everything that depends on the choice."""

    about: str  # a line of the preferences
    build: Callable[[_Asked], Any]  # what is drawn of the points
    # that a laptop takes for a Gaussian; None: an import never takes it by itself
    drawn_ns: float | None = None
    # see-through: needs faint Gaussians, blends, is drawn as ellipsoids where all is one mesh
    soft: bool = False
    native: bool = False  # Blender draws it, from 5.3 on
    sized: bool = False  # ends at the input Ellipsoid Radius
    still: bool = False  # of the points at rest, with their displacement beside them: of moving files alone
    turns: bool = True  # shows how Gaussians turn
    inputs: tuple[str, ...] = ()  # that it alone has


def build_shapes(name: str, materials: Materials) -> Any:
    """Build the node group that turns points into drawn shapes."""
    graph = Graph(bpy.data.node_groups.new(f"{name} Shapes", "GeometryNodeTree"))
    graph.interface("Points", "Geometry")
    graph.interface(names.DRAW, "Int")
    sizes = (
        names.SIZE,
        names.RADIUS,
        names.MIN_OPACITY,
        names.MIN_SPLAT_OPACITY,
        names.ARROW_LENGTH,
        "Growth",
    )
    for socket in sizes:
        graph.interface(socket, "Float")
    graph.interface(names.ARROW_EVERY, "Int", 1)
    graph.interface(names.SOLID_COLOUR, "Bool")
    graph.result("Geometry", "Geometry")
    inputs = graph.inputs()
    points = inputs["Points"]
    solid = graph.choose("MATERIAL", inputs[names.SOLID_COLOUR], materials.solid, materials.points)
    asked = _Asked(graph, points, inputs, solid, materials)
    here = (mode for mode in DRAW_MODES.values() if compat.native_splats() or not mode.native)
    drawn = graph.pick("GEOMETRY", inputs[names.DRAW], *(mode.build(asked) for mode in here))
    flat = _realized(graph, points, drawn)
    graph.finish(Geometry=graph.choose("GEOMETRY", inputs[names.SOLID_COLOUR], drawn, flat))
    return graph.tree


def available(moves: bool) -> dict[str, DrawMode]:
    """Return the names of the draw modes that this Blender offers for a file with or without motion."""
    here = compat.native_splats()
    return {
        name: mode
        for name, mode in DRAW_MODES.items()
        if (moves or not mode.still) and (here or not mode.native)
    }


def is_drawn(graph: Graph, draw: Any, wanted: Callable[[DrawMode], bool]) -> Any:
    """Return a socket that is true if the draw mode with number `draw` satisfies `wanted`."""
    numbers = [i for i, mode in enumerate(DRAW_MODES.values()) if wanted(mode)]
    return graph.either(*(graph.compare("EQUAL", draw, i, "INT") for i in numbers))


def _ellipsoids(asked: _Asked) -> Any:
    radius = asked.size(asked.inputs[names.RADIUS])
    return _balls(asked.graph, asked.points, asked.opaque(names.MIN_OPACITY), radius, asked.solid)


def _splats(asked: _Asked) -> Any:
    # What is see-through adds up, so splats need the faint ones too.
    # Each ray is shaded by its distance from the middle, so that any hull will do.
    faint, radius = asked.opaque(names.MIN_SPLAT_OPACITY), asked.size(SPLAT_RADIUS)
    hull = (AROUND, FEWEST_SUBDIVISIONS)
    return _balls(asked.graph, asked.points, faint, radius, asked.materials.splat, hull)


def _balls(
    graph: Graph,
    points: Any,
    selection: Any,
    radius: Any,
    material: Any,
    ball: tuple[float, int] = (1.0, SUBDIVISIONS),
) -> Any:
    sphere = graph.call(
        "GeometryNodeMeshIcoSphere", dict(zip(("Radius", "Subdivisions"), ball, strict=True)), "Mesh"
    )
    inputs = {
        "Points": points,
        "Instance": graph.painted(sphere, material),
        "Selection": selection,
        "Rotation": graph.attribute(names.ROTATION, "QUATERNION"),
        "Scale": graph.scaled(graph.attribute(names.SCALE, "FLOAT_VECTOR"), radius),
    }
    return graph.call("GeometryNodeInstanceOnPoints", inputs)


def _dots(asked: _Asked) -> Any:
    """Draw round dots of the Gaussians' mean size: a point cloud, the fastest mode.

    Solid view shows point clouds white, so for it they are small balls. `Growth` is a factor for dots alone, which
    Transform Geometry leaves as large as they are.
    """
    graph, points, selection = asked.graph, asked.points, asked.opaque(names.MIN_OPACITY)
    radius, material = asked.size(asked.inputs[names.RADIUS]), asked.materials.points
    size = graph.vector("MULTIPLY", graph.attribute(names.SCALE, "FLOAT_VECTOR"), (1 / 3, 1 / 3, 1 / 3))
    x, y, z = graph.split(size)
    mean = graph.math("MULTIPLY", graph.math("ADD", graph.math("ADD", x, y), z), radius)
    size = graph.math("MULTIPLY", mean, asked.inputs["Growth"])
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
    as_balls = asked.inputs[names.SOLID_COLOUR]
    return graph.choose("GEOMETRY", as_balls, graph.painted(cloud, material), graph.painted(balls, material))


def _native(asked: _Asked) -> Any:
    """Draw a point cloud of Blender's native splats; points.py has already stored their attributes."""
    graph, points, size = asked.graph, asked.points, asked.inputs[names.SIZE]
    scales = graph.scaled(graph.attribute(names.SCALE, "FLOAT_VECTOR"), size)
    sized = graph.store(points, names.SCALE, "FLOAT_VECTOR", scales)
    points = graph.choose("GEOMETRY", graph.compare("EQUAL", size, 1.0), sized, points)
    cloud = graph.call("GeometryNodeMeshToPoints", {"Mesh": points})
    node = graph.node("GeometryNodePointsSetType")
    compat.choose_splats(node)
    graph.put(cloud, node.inputs[0])
    return node.outputs[0]


def _gaussians(graph: Graph, points: Any) -> Any:
    """Return the points without the reference points, whose opacity is negative (points.py)."""
    real = graph.compare("GREATER_EQUAL", graph.attribute(names.OPACITY, "FLOAT"), 0.0)
    return graph.call("GeometryNodeSeparateGeometry", {"Geometry": points, "Selection": real}, domain="POINT")


def _arrows(asked: _Asked) -> Any:
    """Draw an arrow along the displacement of every n-th point, scaled by the input's factor."""
    graph, inputs = asked.graph, asked.inputs
    shift = graph.attribute(names.DISPLACEMENT, "FLOAT_VECTOR")
    length = graph.length(shift)
    index = graph.node("GeometryNodeInputIndex").outputs[0]
    remainder = graph.math("FLOORED_MODULO", index, graph.math("MAXIMUM", inputs[names.ARROW_EVERY], 1))
    chosen = graph.both(
        asked.opaque(names.MIN_OPACITY),
        graph.compare("GREATER_THAN", length, NO_ARROW),
        graph.compare("LESS_THAN", remainder, 0.5),
    )
    place = {
        "Points": asked.points,
        "Instance": graph.painted(_arrow(graph), asked.solid),
        "Selection": chosen,
        "Rotation": graph.call("FunctionNodeAlignRotationToVector", {"Vector": shift}, axis="Z"),
        "Scale": graph.scaled((1.0, 1.0, 1.0), graph.math("MULTIPLY", length, inputs[names.ARROW_LENGTH])),
    }
    return graph.call("GeometryNodeInstanceOnPoints", place)


def _arrow(graph: Graph) -> Any:
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
    """Realise the shapes as one mesh with the points' colours, because Solid view does not colour instances.

    Realising loses which colour attribute is the active one; joining with the points' own mesh, whose loose
    vertices nothing draws, brings that back.
    """
    joined = graph.node("GeometryNodeJoinGeometry")
    graph.put(graph.call("GeometryNodeRealizeInstances", {"Geometry": drawn}), joined.inputs[0])
    graph.put(_gaussians(graph, points), joined.inputs[0])
    return joined.outputs[0]


# A laptop's graphics are taken to manage 200 million triangles a second: 80 of an ellipsoid, 20 of a splat, each of
# these counted three times, as they overlap. The menu's items are in this order; Blender's own come last, as only 5.3
# has them.
DRAW_MODES = {
    "Ellipsoids": DrawMode(
        "Opaque ellipsoids: quick, and right for judging motion", _ellipsoids, drawn_ns=400.0, sized=True
    ),
    "Splats": DrawMode("Soft Gaussians, as they were trained", _splats, drawn_ns=300.0, soft=True),
    "Points": DrawMode(
        "One point for each Gaussian, of the ellipsoid's size", _dots, drawn_ns=0.0, sized=True, turns=False
    ),
    "Arrows": DrawMode(
        "An arrow along each Gaussian's displacement",
        _arrows,
        still=True,
        inputs=(names.ARROW_LENGTH, names.ARROW_EVERY),
    ),
    "Native": DrawMode("Blender's own Gaussian splats", _native, soft=True, native=True),
}
