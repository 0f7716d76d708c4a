"""The scene "ship": a three-masted wooden ship with furled sails in a round disc of sea, on which she rocks.

In the spirit and at the scale of NeRF-synthetic's ship: bow along +x, the sea's disc spans ±1.2 units around
the origin. The hull with all that stands on it is one rigid body; the water is separate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene import AreaLight, Gradient, Part, Scene, part
from ..shapes import ocean
from . import ship_fittings as fittings
from . import ship_hull as hull
from . import ship_rigging as rigging
from . import ship_surfaces as paint
from .ship_plan import HULL, WATER, WATER_RADIUS

_SCALE = 1.17  # of the plan, in which the ship is 2 units long and her middle lies forward of the origin
_SHIFT = np.array([-0.115, 0.0, 0.0])  # before scaling
_LEVEL = _SCALE * WATER


def build() -> Scene:
    """The ship at rest."""
    ship = (*hull.parts(), *fittings.parts(), *rigging.parts())
    return Scene(
        name="ship",
        parts=(*_sea(), *(_placed(part) for part in ship)),
        lights=(AreaLight((2.6, -3.2, 3.8), 3.0, 190.0, (1.0, 0.93, 0.82)),),
        sky=Gradient(((0.16, 0.14, 0.13), (0.55, 0.55, 0.56), (0.75, 0.92, 1.2))),
    )


def _placed(part: Part) -> Part:
    """From the ship's plan to the scene."""
    return replace(part, mesh=replace(part.mesh, vertices=(part.mesh.vertices + _SHIFT) * _SCALE))


def _sea() -> tuple[Part, ...]:
    """The water's surface and the body under it."""
    top, body = ocean.disc(WATER_RADIUS, _LEVEL, 0.225, _swell())
    x, y = ocean.picture_points(WATER_RADIUS, 768)
    stations = np.linspace(0.0, 1.0, 80)
    waterline = (HULL.side(stations, HULL.level(stations, WATER)) + _SHIFT) * _SCALE
    surface = paint.water(ocean.swell(x, y, _swell()), ocean.distance_to(waterline[:, :2], x, y))
    return part("water", top, surface), part("sea_body", body, paint.sea_body())


def _swell() -> np.random.Generator:
    """The waves of the mesh are those of the picture."""
    return np.random.default_rng([2031, 0])
