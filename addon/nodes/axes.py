"""The axis of a file that points up."""

import math
from typing import Any

from mathutils import Matrix

from .. import names

FILE, MINUS_Y, PLUS_Y = "FILE", "MINUS_Y", "PLUS_Y"
# About x, radians: what turns this up into Blender's.
TURNS = {FILE: 0.0, MINUS_Y: -math.pi / 2, PLUS_Y: math.pi / 2}
LABELS = {FILE: "Z", MINUS_Y: "−Y", PLUS_Y: "Y"}


def stand_up(obj: Any, axes: str) -> None:
    """Turn an object, about the world's x axis, so that this axis of its file points up."""
    turn = TURNS[axes] - TURNS[str(obj.get(names.AXES, FILE))]
    obj.matrix_world = Matrix.Rotation(turn, 4, "X") @ obj.matrix_world
    obj[names.AXES] = axes
