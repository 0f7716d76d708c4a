"""Differences between Blender 4.5, 5.2 and 5.3. The code tests for features, not for versions."""

from typing import Any

import bpy

from tg4mm.core.errors import Tg4mmError

NEWEST_TRIED = (5, 3)
LARGEST = 1e30  # of a modifier's numbers: times what it is multiplied with, float32 still holds it
# 5.2 keeps the inputs of a Geometry Nodes modifier as properties, 4.5 as custom properties.
_INPUTS_ARE_PROPERTIES = "properties" in bpy.types.NodesModifier.bl_rna.properties


class MissingInBlender(Tg4mmError):
    """Raised when this Blender lacks a feature that the extension needs."""

    def __init__(self, what: str) -> None:
        super().__init__(f"Blender {bpy.app.version_string} has no {what}; TG4MM is tested up to {_tried()}")


def untried() -> str:
    """Return a warning if this Blender is newer than any tested version, else ""."""
    new = bpy.app.version[:2] > NEWEST_TRIED
    return f"Blender {bpy.app.version_string}: tested up to {_tried()}" if new else ""


def _tried() -> str:
    return ".".join(map(str, NEWEST_TRIED))


def find_input(modifier: Any, name: str) -> Any:
    """Return the interface item of the modifier's input called `name`. Raises KeyError if there is none."""
    for item in modifier.node_group.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == name:
            return item
    raise KeyError(f"{modifier.name} has no input {name!r}")


def has_input(modifier: Any, name: str) -> bool:
    """Return whether the modifier's node group has an input called `name`."""
    items = modifier.node_group.interface.items_tree
    return any(i.item_type == "SOCKET" and i.in_out == "INPUT" and i.name == name for i in items)


def get_input(modifier: Any, name: str) -> Any:
    """Return the value of a modifier's input; for a menu, the name of the item."""
    item = find_input(modifier, name)
    if _INPUTS_ARE_PROPERTIES:
        return getattr(modifier.properties.inputs, item.identifier).value
    value = modifier[item.identifier]
    return _menu_names(modifier, item)[value] if item.socket_type == "NodeSocketMenu" else value


def is_number(value: float) -> bool:
    """Return False for NaN, infinity, and the largest float32, to which Blender 5.3 clamps infinity."""
    return abs(value) < LARGEST


def get_number(modifier: Any, name: str) -> float:
    """Return a numeric input as the node tree uses it: non-finite values count as 0."""
    value = float(get_input(modifier, name))
    return value if is_number(value) else 0.0


def set_input(modifier: Any, name: str, value: Any) -> None:
    """Set a modifier's input and tag its object for evaluation, which Blender does not do from Python.

    The value of a menu is the item's name. Raises ValueError for an unknown item.
    """
    item = find_input(modifier, name)
    if item.socket_type == "NodeSocketMenu":
        names = _menu_names(modifier, item)
        if value not in names.values():
            raise ValueError(f"{name} is {value!r}; expected one of {', '.join(names.values())}")
        if not _INPUTS_ARE_PROPERTIES:
            value = next(number for number, known in names.items() if known == value)
    if _INPUTS_ARE_PROPERTIES:
        getattr(modifier.properties.inputs, item.identifier).value = value
    else:
        modifier[item.identifier] = value
    modifier.id_data.update_tag()


def draw_input(layout: Any, modifier: Any, name: str, **options: Any) -> None:
    """Draw a modifier's input; the button can be keyed and driven like any other."""
    identifier = find_input(modifier, name).identifier
    options.setdefault("text", name)
    if _INPUTS_ARE_PROPERTIES:
        layout.prop(getattr(modifier.properties.inputs, identifier), "value", **options)
    else:
        layout.prop(modifier, f'["{identifier}"]', **options)


def input_path(modifier: Any, name: str) -> str:
    """Return the data path of a modifier's input from its object, for keyframe_insert and driver_add."""
    identifier = find_input(modifier, name).identifier
    tail = f".properties.inputs.{identifier}.value" if _INPUTS_ARE_PROPERTIES else f'["{identifier}"]'
    return f'modifiers["{bpy.utils.escape_identifier(modifier.name)}"]{tail}'


def native_splats() -> bool:
    """Return whether Blender itself draws point clouds of Gaussian splats (5.3 and later)."""
    return hasattr(bpy.types, "GeometryNodePointsSetType")


def choose_splats(node: Any) -> None:
    """Set a Set Point Cloud Type node to Gaussian splats. Raises MissingInBlender if it lacks that type."""
    try:
        node.inputs["Type"].default_value = "3D Gaussian Splat"
    except (KeyError, TypeError) as error:
        raise MissingInBlender("Gaussian splats in the node Set Point Cloud Type") from error


def use_nodes(material: Any) -> None:
    """Give a new material a node tree, which 5.x does by itself."""
    if material.node_tree is None:
        material.use_nodes = True


def transform_by_matrix(node: Any) -> None:
    """Let a Transform Geometry node take a matrix: a property in 4.5, a socket in 5.2."""
    if hasattr(node, "mode"):
        node.mode = "MATRIX"
    else:
        node.inputs["Mode"].default_value = "Matrix"


def match_wildcard(node: Any) -> None:
    """Let a Remove Named Attribute node take a pattern: a property in 4.5, a socket in 5.2."""
    if hasattr(node, "pattern_mode"):
        node.pattern_mode = "WILDCARD"
    else:
        node.inputs["Pattern Mode"].default_value = "Wildcard"


def _menu_names(modifier: Any, item: Any) -> dict[int, str]:
    """Return {number: name} for the items of a menu input. Blender numbers them from 0 in order of creation."""
    group = next(node for node in modifier.node_group.nodes if node.bl_idname == "NodeGroupInput")
    socket = next(out for out in group.outputs if out.identifier == item.identifier)
    switch = socket.links[0].to_node
    return {number: enum_item.name for number, enum_item in enumerate(switch.enum_items)}
