"""A short notation for creating and linking the nodes of one tree."""

from collections.abc import Sequence
from functools import partial, reduce
from types import TracebackType
from typing import Any

import bpy

from .. import compat

Value = Any  # an output socket, or a plain number, text or data-block for the socket's default


class Graph:
    """Writes a node tree as expressions: each method makes a node and returns its output socket."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def interface(self, name: str, kind: str, default: Value = None, **limits: Any) -> Any:
        """A new input of the tree. `kind` as in NodeSocket<kind>; limits: min_value, max_value, description …"""
        socket = self.tree.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
        if default is not None:
            socket.default_value = default
        for key, value in limits.items():
            setattr(socket, key, value)
        return socket

    def result(self, name: str, kind: str) -> None:
        """A new output of the tree."""
        self.tree.interface.new_socket(name, in_out="OUTPUT", socket_type=f"NodeSocket{kind}")

    def inputs(self) -> Any:
        """Return the tree's inputs by name, once all are declared."""
        return self.node("NodeGroupInput").outputs

    def finish(self, **results: Value) -> None:
        """Link the tree's outputs, given by name with _ for a space, and lay the nodes out."""
        output = self.node("NodeGroupOutput")
        for name, value in results.items():
            self.put(value, output.inputs[name.replace("_", " ")])
        self.arrange()

    def node(self, kind: str, **properties: Any) -> Any:
        """Create a node with its properties set. Raises MissingInBlender if the node type does not exist."""
        try:
            node = self.tree.nodes.new(kind)
        except RuntimeError as error:
            raise compat.MissingInBlender(f"node {kind}") from error
        for name, value in properties.items():
            setattr(node, name, value)
        return node

    def put(self, value: Value, socket: Any) -> None:
        """Link an output to a socket, or set the socket's default."""
        if hasattr(value, "is_output"):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def call(self, kind: str, inputs: dict[str, Value], output: str | int = 0, **properties: Any) -> Any:
        """A node with inputs set by the names of its enabled sockets; returns one of its enabled outputs."""
        node = self.node(kind, **properties)
        for name, value in inputs.items():
            self.put(value, _enabled(node, node.inputs, name))
        return _enabled(node, node.outputs, output)

    def group(self, tree: Any, **inputs: Value) -> Any:
        """A node of a group; inputs by name with _ for a space; returns its outputs."""
        node = self.node("GeometryNodeGroup", node_tree=tree)
        for name, value in inputs.items():
            self.put(value, node.inputs[name.replace("_", " ")])
        return node.outputs

    def math(self, operation: str, *values: Value) -> Any:
        return self._operate("ShaderNodeMath", operation, values)

    def vector(self, operation: str, *values: Value) -> Any:
        """Add a vector math node with a vector result; constants are 3-tuples."""
        return self._operate("ShaderNodeVectorMath", operation, values)

    def length(self, vector: Value) -> Any:
        return self.call("ShaderNodeVectorMath", {"Vector": vector}, "Value", operation="LENGTH")

    def scaled(self, vector: Value, factor: Value) -> Any:
        return self.call("ShaderNodeVectorMath", {"Vector": vector, "Scale": factor}, operation="SCALE")

    def split(self, vector: Value) -> Any:
        """The outputs X, Y, Z of a vector."""
        node = self.node("ShaderNodeSeparateXYZ")
        self.put(vector, node.inputs[0])
        return node.outputs

    def both(self, *conditions: Value) -> Any:
        """True where all conditions are."""
        return reduce(partial(self._logic, "AND"), conditions)

    def either(self, *conditions: Value) -> Any:
        """True where any condition is."""
        return reduce(partial(self._logic, "OR"), conditions)

    def opposite(self, condition: Value) -> Any:
        """True where the condition does not hold."""
        return self._logic("NOT", condition)

    def _logic(self, operation: str, *conditions: Value) -> Any:
        return self._operate("FunctionNodeBooleanMath", operation, conditions)

    def compare(self, operation: str, a: Value, b: Value, data_type: str = "FLOAT") -> Any:
        inputs = {"A": a, "B": b}
        return self.call("FunctionNodeCompare", inputs, data_type=data_type, operation=operation)

    def finite(self, value: Value) -> Any:
        """Return a number, replacing NaN and infinity by 0 (compat.is_number)."""
        is_number = self.compare("LESS_THAN", self.math("ABSOLUTE", value), compat.LARGEST)
        return self.choose("FLOAT", is_number, 0.0, value)

    def choose(self, data_type: str, condition: Value, no: Value, yes: Value) -> Any:
        """`yes` where the condition holds, else `no`; the branch not taken is not computed."""
        inputs = {"Switch": condition, "False": no, "True": yes}
        return self.call("GeometryNodeSwitch", inputs, input_type=data_type)

    def pick(self, data_type: str, index: Value, *values: Value) -> Any:
        """Return values[index]; the others are not evaluated."""
        node = self.node("GeometryNodeIndexSwitch", data_type=data_type)
        while len(node.index_switch_items) < len(values):
            node.index_switch_items.new()
        self.put(index, node.inputs["Index"])
        for i, value in enumerate(values):
            self.put(value, node.inputs[str(i)])
        return node.outputs[0]

    def menu(self, socket: Value, items: dict[str, int]) -> Any:
        """The number of the item that a menu input of the tree is set to."""
        node = self.node("GeometryNodeMenuSwitch", data_type="INT")
        # A new node has two items, numbered 0 and 1; cleared items would leave these numbers unused, and
        # compat relies on them.
        for i, (item, number) in enumerate(items.items()):
            if i < len(node.enum_items):
                node.enum_items[i].name = item
            else:
                node.enum_items.new(item)
            node.inputs[item].default_value = number
        self.put(socket, node.inputs["Menu"])
        return node.outputs[0]

    def attribute(self, name: Value, data_type: str) -> Any:
        return self.call("GeometryNodeInputNamedAttribute", {"Name": name}, "Attribute", data_type=data_type)

    def store(self, geometry: Value, name: str, data_type: str, value: Value) -> Any:
        """The geometry with a named attribute of its points set."""
        inputs = {"Geometry": geometry, "Name": name, "Value": value}
        return self.call("GeometryNodeStoreNamedAttribute", inputs, data_type=data_type, domain="POINT")

    def without(self, geometry: Value, pattern: str) -> Any:
        """The geometry without the attributes whose names fit `pattern`."""
        node = self.node("GeometryNodeRemoveAttribute")
        compat.match_wildcard(node)
        self.put(geometry, node.inputs["Geometry"])
        self.put(pattern, node.inputs["Name"])
        return node.outputs[0]

    def repeat(self, times: Value) -> tuple[Any, Any, Any]:
        """A zone that is evaluated `times` times and joins geometries: the number of the turn, from 0; what there is so
        far; and the zone's end, to be given to `repeated`."""
        start, end = self.node("GeometryNodeRepeatInput"), self.node("GeometryNodeRepeatOutput")
        start.pair_with_output(end)
        self.put(times, start.inputs["Iterations"])
        return start.outputs["Iteration"], start.outputs["Geometry"], end

    def repeated(self, end: Any, before: Value, geometry: Value) -> Any:
        """Add a turn's geometry to what there is so far; returns what there is after the last."""
        joined = self.node("GeometryNodeJoinGeometry")
        for part in (geometry, before):  # what is linked last comes first
            self.put(part, joined.inputs[0])
        self.put(joined.outputs[0], end.inputs["Geometry"])
        return end.outputs["Geometry"]

    def painted(self, geometry: Value, material: Value) -> Any:
        return self.call("GeometryNodeSetMaterial", {"Geometry": geometry, "Material": material})

    def _operate(self, kind: str, operation: str, values: Sequence[Value]) -> Any:
        node = self.node(kind, operation=operation)
        for value, socket in zip(values, node.inputs, strict=False):
            self.put(value, socket)
        return node.outputs[0]

    def arrange(self, column: int = 190, row: int = 170) -> None:
        """Lay the nodes out in columns: every node right of what it reads."""
        depth = {node.name: 0 for node in self.tree.nodes}
        made = {name: number for number, name in enumerate(depth)}  # mostly after what they read
        links = ((link.from_node.name, link.to_node.name) for link in self.tree.links)
        pairs = sorted(links, key=lambda pair: made[pair[1]])
        for _ in depth:
            changed = False
            for source, target in pairs:
                if depth[target] <= depth[source]:
                    depth[target], changed = depth[source] + 1, True
            if not changed:
                break
        rows: dict[int, int] = {}
        for node in self.tree.nodes:
            x = depth[node.name]
            node.location = x * column, -rows.get(x, 0) * row
            rows[x] = rows.get(x, 0) + 1


def _enabled(node: Any, sockets: Any, wanted: str | int) -> Any:
    """The socket in use that is called so or has that number. MissingInBlender without one."""
    enabled = [socket for socket in sockets if socket.enabled]
    if isinstance(wanted, int):
        return enabled[wanted]
    for socket in enabled:
        if socket.name == wanted:
            return socket
    raise compat.MissingInBlender(f"socket {wanted} of the node {node.bl_idname}")


class Made:
    """`with Made() as made:` removes every data-block given to `keep` if the block leaves by an exception."""

    def __init__(self) -> None:
        self._blocks: list[Any] = []

    def keep(self, block: Any) -> Any:
        """Remember a data-block that was just made; returns it."""
        self._blocks.append(block)
        return block

    def __enter__(self) -> "Made":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None and self._blocks:
            bpy.data.batch_remove(self._blocks)
