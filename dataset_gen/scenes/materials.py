"""The scene "materials": twelve balls of different stuff, each on a ring, on an inlaid tray that stands still.

In the spirit and at the scale of NeRF-synthetic's materials: three rows of four. Every ball wobbles on its ring like a
soft body, each with a phase and a direction of its own.
"""

from __future__ import annotations

import numpy as np

from .. import meshes as m
from ..patterns.solid import of_grid
from ..scene import AreaLight, Gradient, Part, Scene, part
from ..shapes.cushion import Outline, bead_section, frames_on, moulding
from ..shapes.sheet import puff, puff_points, rounded
from . import materials_surfaces as paint

RADIUS = 0.22  # of a ball
SPACING = 0.55
BOARD = -0.25  # the board's upper face
RING, WIRE = 0.115, 0.022  # radius of a ring and of its bead
_RING_Z = BOARD + WIRE - 0.004  # sunk a little into its groove
BALL_Z = _RING_Z + float(np.sqrt((RADIUS + WIRE) ** 2 - RING**2))
TRAY = Outline(1.13, 0.86, 7.0)
# Rows from the back to the front; neighbours differ in shine and in colour.
LAYOUT = (
    ("gold", "marble", "leather", "paint"),
    ("velvet", "steel", "leopard", "glass"),
    ("wood", "checker", "copper", "clay"),
)


def places() -> dict[str, np.ndarray]:
    """The centre [3] of every ball, by the name of its material."""
    return {
        name: np.array([(column - 1.5) * SPACING, (1 - row) * SPACING, BALL_Z])
        for row, names in enumerate(LAYOUT)
        for column, name in enumerate(names)
    }


def build() -> Scene:
    """The balls at rest."""
    balls = [_ball(name, place, number) for number, (name, place) in enumerate(places().items())]
    return Scene(
        name="materials",
        parts=(*balls, *_tray()),
        lights=(AreaLight((2.4, -2.8, 4.0), 3.0, 170.0, (1.0, 0.96, 0.89)),),
        sky=Gradient(((0.22, 0.18, 0.16), (0.42, 0.42, 0.44), (0.75, 0.82, 0.95), (1.0, 1.05, 1.15))),
    )


def _ball(name: str, place: np.ndarray, number: int) -> Part:
    """A ball whose poles lie aslant, each its own way."""
    arc = [(RADIUS * np.cos(a), RADIUS * np.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, 49)]
    arc[0], arc[-1] = (0.0, -RADIUS), (0.0, RADIUS)
    heading, tilt = 2.4 * number + 0.5, np.radians(38.0 + 9.0 * (number % 4))
    axis = (np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt))
    return part(f"ball_{name}", m.revolve(arc, 80).moved(m.frame(place, axis)), paint.BALLS[name]())


def _tray() -> list[Part]:
    """Board with inlays, raised rim, feet, and the rings under the balls."""
    flat, share = TRAY.disc(72)
    middle = np.dstack([flat, np.full(share.shape, BOARD - 0.02)])
    above, below = 0.02 * rounded(share, 30.0), 0.035 * rounded(share, 30.0)
    texels = of_grid(puff_points(middle, above, below), 704, 512)

    def level(points: np.ndarray) -> np.ndarray:
        return np.concatenate([points, np.full((*points.shape[:-1], 1), BOARD - 0.005)], -1)

    rim = moulding(*frames_on(level, TRAY.rim(320, 0.03)), bead_section(0.085, 0.13, 4, 0.12))
    bead = moulding(
        *frames_on(lambda p: level(p) + [0.0, 0.0, 0.062], TRAY.rim(320, 0.03)), m.circle(0.016, 12)
    )
    feet = [(0.0, -0.058), (0.05, -0.058), (0.062, -0.045), (0.055, -0.02), (0.045, 0.0), (0.0, 0.0)]
    corners = [
        m.revolve(feet, 28).moved(m.shift((x, y, BOARD - 0.05))) for x in (-0.92, 0.92) for y in (-0.66, 0.66)
    ]
    turn = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    circle = RING * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    ring = m.sweep(circle, m.circle(WIRE, 16), closed=True)
    rings = [ring.moved(m.shift((place[0], place[1], _RING_Z))) for place in places().values()]
    return [
        part("board", puff(middle, above, below), paint.board(texels, list(places().values()))),
        part("rim", rim, paint.rim()),
        part("rim_bead", bead, paint.bead("rim_bead", 150.0)),
        part("feet", m.join(corners), paint.bead("feet", 8.0)),
        part("rings", m.join(rings), paint.bead("rings", 18.0)),
    ]
