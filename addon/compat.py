"""Where Blender 4.5 and 5.2 differ; nothing else in the extension asks for the version."""

from __future__ import annotations

from typing import Any

import bpy

# 5.2 keeps the inputs of a Geometry Nodes modifier as properties, 4.5 as custom properties (design §3).
_INPUTS_ARE_PROPERTIES = bpy.app.version >= (5, 2, 0)


def input_identifier(modifier: Any, name: str) -> str:
    """The identifier, such as Socket_2, of the modifier's input called `name`. KeyError without one."""
    for item in modifier.node_group.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == name:
            return item.identifier
    raise KeyError(f"{modifier.name} has no input {name!r}")


def get_input(modifier: Any, name: str) -> Any:
    """The value of a modifier's input."""
    identifier = input_identifier(modifier, name)
    if _INPUTS_ARE_PROPERTIES:
        return getattr(modifier.properties.inputs, identifier).value
    return modifier[identifier]


def set_input(modifier: Any, name: str, value: Any) -> None:
    """Set a modifier's input and mark its object for evaluation, which Blender does not do from Python."""
    identifier = input_identifier(modifier, name)
    if _INPUTS_ARE_PROPERTIES:
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value
    modifier.id_data.update_tag()


def draw_input(layout: Any, modifier: Any, name: str) -> None:
    """Draw a modifier's input; the button can be keyed and driven like any other."""
    identifier = input_identifier(modifier, name)
    if _INPUTS_ARE_PROPERTIES:
        layout.prop(getattr(modifier.properties.inputs, identifier), "value", text=name)
    else:
        layout.prop(modifier, f'["{identifier}"]', text=name)


def key_input(modifier: Any, name: str, frame: float) -> None:
    """Insert a key of a modifier's input at `frame`."""
    identifier = input_identifier(modifier, name)
    tail = f"properties.inputs.{identifier}.value" if _INPUTS_ARE_PROPERTIES else f'["{identifier}"]'
    dot = "." if _INPUTS_ARE_PROPERTIES else ""
    modifier.id_data.keyframe_insert(f'modifiers["{modifier.name}"]{dot}{tail}', frame=frame)
