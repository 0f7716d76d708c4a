"""What opening a user's file gives."""

from __future__ import annotations

from dataclasses import dataclass

from ..build import Stage
from ..cameras import Camera
from ..vibration.bodies import Body


@dataclass(frozen=True)
class Loaded:
    """A user's scene, at rest, in the Blender session of this process."""

    stage: Stage  # its `objects` and `rest` go with `bodies`, one to one
    bodies: tuple[Body, ...]
    unit_scale_m: float | None  # metres per scene unit, None where the file does not say
    own_unit: tuple[str, float]  # of the file: its name, and how many of it a scene unit is
    cameras: tuple[Camera, ...]  # of the file, the active one first
    camera_names: tuple[str, ...]  # one for each of `cameras`
    warnings: tuple[str, ...]  # one line each: what was left out or replaced
    centre: tuple[float, float, float]  # of the sphere around what is to be looked at, scene units
    radius: float  # of that sphere, scene units
