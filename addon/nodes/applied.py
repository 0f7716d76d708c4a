"""Nodes that recover the transform applied by Apply Transform (Ctrl+A) from four reference vertices.

Apply moves the points and leaves what is kept beside them: phasors, turns, sizes, harmonics. So every mesh ends in four
vertices that are no Gaussians: a middle, and a step from it along x, y and z, with their number, 1 to 4, and their
first places. Where they are now against where they were is the affine map A that was applied. The tree takes the points
to rest by A⁻¹, plays, and applies A to what is drawn. Join puts meshes one after another: each part ends in references
of its own.
"""

from typing import Any, NamedTuple

import bpy

from .. import compat, names
from .graph import Graph

LOST = "Reference points are missing or duplicated: motion and sizes do not follow Apply Transform"
OTHER = "Joined with a file of other frequencies: that part moves at this file's frequencies"
_EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Applied(NamedTuple):
    """Single-value sockets of the tree."""

    matrix: Any  # A, from rest to now; the identity where the references are lost
    back: Any  # A⁻¹
    changed: Any  # A is not the identity


def build_applied(name: str, modes: int) -> Any:
    """A node group: of the points of one part A, and the points with a warning where references are lost or another
    file's. `modes`: names.modes_number of the file."""
    graph = Graph(bpy.data.node_groups.new(f"{name} Applied", "GeometryNodeTree"))
    graph.interface("Points", "Geometry")
    for socket, kind in (
        ("Points", "Geometry"),
        ("Matrix", "Matrix"),
        ("Back", "Matrix"),
        ("Changed", "Bool"),
    ):
        graph.result(socket, kind)
    points = graph.inputs()["Points"]
    four = _references(graph, points)
    now = _sampled(graph, four, graph.node("GeometryNodeInputPosition").outputs[0])
    rest = _sampled(graph, four, graph.attribute(names.REFERENCE_REST, "FLOAT_VECTOR"))
    product = _product(graph, _frame(graph, now), _inverse(graph, _frame(graph, rest))[0])
    back, regular = _inverse(graph, product)
    whole = graph.both(graph.compare("EQUAL", _count(graph, four), 4, "INT"), regular)
    away = [graph.length(graph.vector("SUBTRACT", a, b)) for a, b in zip(now, rest, strict=True)]
    total = graph.math("ADD", graph.math("ADD", away[0], away[1]), graph.math("ADD", away[2], away[3]))
    changed = graph.both(whole, graph.compare("GREATER_THAN", total, 0.0))
    eye = _combined(graph, (*_EYE, (0.0, 0.0, 0.0)))
    some = graph.compare("GREATER_THAN", _count(graph, points), 0, "INT")
    lost = graph.both(some, graph.opposite(whole))
    number = {"Geometry": four, "Value": graph.attribute(names.REFERENCE_MODES, "INT"), "Index": 0}
    of = graph.call("GeometryNodeSampleIndex", number, data_type="INT", domain="POINT")
    other = graph.both(whole, graph.compare("NOT_EQUAL", of, modes, "INT"))
    for said, message in ((lost, LOST), (other, OTHER)):
        warned = graph.call("GeometryNodeWarning", {"Show": said, "Message": message}, warning_type="WARNING")
        points = graph.choose("GEOMETRY", warned, points, points)  # it counts where its output is used
    graph.finish(
        Points=points,
        Matrix=graph.choose("MATRIX", changed, eye, product),
        Back=graph.choose("MATRIX", changed, eye, back),
        Changed=changed,
    )
    return graph.tree


def applied(graph: Graph, tree: Any, points: Any) -> tuple[Applied, Any]:
    """Add a node of the group; return A of one part's points, and the points."""
    outputs = graph.group(tree, Points=points)
    return Applied(*(outputs[name] for name in ("Matrix", "Back", "Changed"))), outputs["Points"]


def at_rest(graph: Graph, applied: Applied, place: Any) -> Any:
    """Return a position as it was before Apply Transform."""
    there = graph.call("FunctionNodeTransformPoint", {"Vector": place, "Transform": applied.back})
    return graph.choose("VECTOR", applied.changed, place, there)


def put_back(graph: Graph, applied: Applied, drawn: Any, native: Any | None) -> Any:
    """Move what is drawn at rest to its present position. `native`: true where it is a cloud of Blender's own splats.

    Transform Geometry moves the positions of such a cloud alone; as an instance it is drawn as it should be.
    """
    node = graph.node("GeometryNodeTransform")
    compat.transform_by_matrix(node)
    graph.put(drawn, node.inputs["Geometry"])
    graph.put(applied.matrix, next(s for s in node.inputs if s.bl_idname == "NodeSocketMatrix"))
    moved = node.outputs[0]
    if native is not None:
        one = graph.call("GeometryNodeGeometryToInstance", {"Geometry": drawn})
        inputs = {"Instances": one, "Transform": applied.matrix}
        moved = graph.choose(
            "GEOMETRY", native, moved, graph.call("GeometryNodeSetInstanceTransform", inputs)
        )
    return graph.choose("GEOMETRY", applied.changed, drawn, moved)


def growth(graph: Graph, applied: Applied) -> Any:
    """Return A's mean length factor, the cube root of its volume factor, for dots, which A does not scale."""
    volume = graph.call("FunctionNodeMatrixDeterminant", {"Matrix": applied.matrix})
    return graph.math("POWER", graph.math("ABSOLUTE", volume), 1 / 3)


def parts(graph: Graph, points: Any) -> tuple[Any, Any]:
    """Return the number of joined parts, and each point's part index from 0.

    A part ends with its fourth reference. With four references in all there is one part, whatever else was added.
    """
    last = graph.compare("EQUAL", graph.attribute(names.REFERENCE, "INT"), 4, "INT")
    ended = graph.call(
        "GeometryNodeAccumulateField", {"Value": last}, "Trailing", data_type="INT", domain="POINT"
    )
    four = graph.compare("EQUAL", _count(graph, _references(graph, points)), 4, "INT")
    highest = graph.call(
        "GeometryNodeAttributeStatistic",
        {"Geometry": points, "Attribute": ended},
        "Max",
        data_type="FLOAT",
        domain="POINT",
    )
    return graph.choose("INT", four, graph.math("ADD", highest, 1.0), 1), ended


def _references(graph: Graph, points: Any) -> Any:
    marked = graph.compare("GREATER_THAN", graph.attribute(names.REFERENCE, "INT"), 0, "INT")
    inputs = {"Geometry": points, "Selection": marked}
    return graph.call("GeometryNodeSeparateGeometry", inputs, domain="POINT")


def _count(graph: Graph, points: Any) -> Any:
    return graph.call("GeometryNodeAttributeDomainSize", {"Geometry": points}, "Point Count")


def _sampled(graph: Graph, four: Any, value: Any) -> list[Any]:
    kinds = {"data_type": "FLOAT_VECTOR", "domain": "POINT"}
    inputs = {"Geometry": four, "Value": value}
    return [graph.call("GeometryNodeSampleIndex", {**inputs, "Index": i}, **kinds) for i in range(4)]


def _frame(graph: Graph, four: list[Any]) -> Any:
    """Return the matrix that maps unit steps along x, y and z to the positions of four points."""
    edges = [graph.vector("SUBTRACT", place, four[0]) for place in four[1:]]
    return _combined(graph, (*edges, four[0]))


def _combined(graph: Graph, columns: Any) -> Any:
    """Combine four columns, vectors or numbers, into a matrix; the last is the origin."""
    node = graph.node("FunctionNodeCombineMatrix")
    for j, column in enumerate(columns):
        rows = graph.split(column) if hasattr(column, "is_output") else column
        for i in range(3):
            graph.put(rows[i], node.inputs[4 * j + i])
        node.inputs[4 * j + 3].default_value = float(j == 3)
    return node.outputs[0]


def _product(graph: Graph, a: Any, b: Any) -> Any:
    node = graph.node("FunctionNodeMatrixMultiply")
    graph.put(a, node.inputs[0])
    graph.put(b, node.inputs[1])
    return node.outputs[0]


def _inverse(graph: Graph, matrix: Any) -> Any:
    node = graph.node("FunctionNodeInvertMatrix")
    graph.put(matrix, node.inputs[0])
    return node.outputs
