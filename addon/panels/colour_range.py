"""The panel's colour range field, in millimetres or scene units, with suitable decimals.

The modifier's own input is in scene units and shows three decimals, too few for most motions. Blender fixes a
field's decimals when it is made, so there is a field for each number of them, all of one value.
"""

import math
from collections.abc import Callable
from typing import Any

import bpy
from bpy.props import FloatProperty

from .. import compat, names, preferences
from ..nodes import scene

DECIMALS = range(2, 7)  # 6 are the most that Blender shows


def draw(layout: Any, context: Any, obj: Any) -> None:
    """Draw the field with its unit."""
    unit = preferences.unit_for(context, obj)
    largest = max(obj[names.MODE_AMPLITUDES], default=0.0) * unit.per_scene_unit
    layout.prop(obj, _field(decimals_for(largest)), text=f"Range ({unit.short})")


def decimals_for(length: float) -> int:
    """Return the number of decimals that show four digits of a length, within Blender's limit."""
    digits = DECIMALS.stop if length <= 0 else 3 - math.floor(math.log10(length))
    return min(max(digits, DECIMALS.start), DECIMALS.stop - 1)


def _field(decimals: int) -> str:
    return f"tg4mm_colour_range_{decimals}"


def _per_scene_unit(obj: Any) -> float:
    return preferences.unit_for(bpy.context, obj).per_scene_unit


def _get(obj: Any) -> float:
    modifier = scene.splat_modifier(obj)
    return 0.0 if modifier is None else compat.get_input(modifier, names.COLOUR_RANGE) * _per_scene_unit(obj)


def _set(obj: Any, value: float) -> None:
    compat.set_input(scene.splat_modifier(obj), names.COLOUR_RANGE, value / _per_scene_unit(obj))


def _property(decimals: int) -> Callable[..., Any]:
    return FloatProperty(
        name="Colour Range",
        description="Amplitude shown in the last colour of the map, in millimetres if the file states its scale, "
        "else in scene units",
        min=0.0,
        soft_max=10.0 ** (4 - decimals),
        precision=decimals,
        get=_get,
        set=_set,
    )


def register() -> None:
    for decimals in DECIMALS:
        setattr(bpy.types.Object, _field(decimals), _property(decimals))


def unregister() -> None:
    for decimals in DECIMALS:
        delattr(bpy.types.Object, _field(decimals))
