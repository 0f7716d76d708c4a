"""The scene "materials": twelve balls on a tray, one pattern in space for each; balls roll in their rings."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from .. import meshes as m
from .. import textures as t
from ..patterns import minerals
from ..patterns import solid as unroll
from ..patterns.furnishing import HONEY, WALNUT, damask, wood
from ..patterns.minerals import Painted
from ..patterns.solid import fractal, mix, noise, of_grid, ramp, step, unit
from ..scene import AreaLight, Gradient, Part, Scene, Surface, part
from ..shapes.sheet import Outline, bead_section, frames_on, moulding, puff, puff_points, rounded

_SIZE = (256, 544)
RADIUS = 0.22  # of a ball
SPACING = 0.55
BOARD = -0.25  # the board's upper face

TRAY = Outline(1.13, 0.86, 7.0)
# Rows from the back to the front; neighbours differ in shine and in colour.
LAYOUT = (
    ("gold", "marble", "leather", "paint"),
    ("velvet", "steel", "leopard", "glass"),
    ("wood", "checker", "copper", "clay"),
)
RING, WIRE = 0.115, 0.022  # radius of a ring and of its bead
_RING_Z = BOARD + WIRE - 0.004  # sunk a little into its groove
BALL_Z = _RING_Z + float(np.sqrt((RADIUS + WIRE) ** 2 - RING**2))


def _directions() -> np.ndarray:
    return unroll.of_ball(*_SIZE)


def _stuff(
    name: str, pattern: Callable[[np.ndarray, int], Painted], seed: int, depth: float = 0.0, **more: Any
) -> Surface:
    image, relief, rough = pattern(_directions(), seed)
    if not depth:
        return Surface(name, image, roughness=rough, **more)
    return Surface(name, image, relief, depth, roughness=rough, **more)


def _wood() -> Surface:
    image, pores = wood(_directions() * 0.4, 22.0, HONEY, 10)
    return Surface(
        "wood", image, unit(0.6 - 0.4 * pores), 0.004, roughness=0.35, coat=0.6, coat_roughness=0.08
    )


def _checker() -> Surface:
    p = _directions()
    squares = t.checker(*_SIZE, (10, 16))
    worn, fine = fractal(p, 3.0, 3, 30), fractal(p, 18.0, 2, 31)
    dark = ramp(0.5 + 0.3 * worn + 0.15 * fine, [(0.0, (0.04, 0.05, 0.09)), (1.0, (0.22, 0.24, 0.34))])
    light = ramp(0.5 + 0.25 * worn + 0.15 * fine, [(0.0, (0.82, 0.76, 0.64)), (1.0, (0.99, 0.96, 0.9))])
    return Surface(
        "checker", unit(mix(dark, light, squares)), unit(0.45 + 0.1 * squares), 0.003, roughness=0.22,
        coat=0.3,
    )  # fmt: skip


def _velvet() -> Surface:
    p = _directions()
    turn, height = np.arctan2(p[..., 1], p[..., 0]), np.arcsin(np.clip(p[..., 2], -1.0, 1.0))
    figure = damask(turn, height, (2.0 * np.pi / 7.0, np.pi / 3.0))
    nap, fine = fractal(p, 2.2, 3, 40), noise(p, 20.0, 41)
    pile = ramp(0.5 + 0.25 * nap + 0.12 * fine, [(0.0, (0.24, 0.04, 0.28)), (1.0, (0.55, 0.16, 0.56))])
    raised = ramp(0.5 + 0.2 * nap + 0.15 * fine, [(0.0, (0.66, 0.36, 0.66)), (1.0, (0.93, 0.72, 0.86))])
    return Surface(
        "velvet", unit(mix(pile, raised, figure)), unit(0.4 + 0.06 * fine + 0.3 * figure), 0.006,
        roughness=0.9, sheen=0.8,
    )  # fmt: skip


BALLS: dict[str, Callable[[], Surface]] = {
    "gold": partial(_stuff, "gold", minerals.hammered, 1, 0.02, metallic=0.95),
    "steel": partial(_stuff, "steel", minerals.brushed, 2, 0.003, metallic=0.9),
    "copper": partial(_stuff, "copper", minerals.patina, 3, 0.008, metallic=0.55),
    "marble": partial(_stuff, "marble", minerals.marble, 4, 0.002, coat=0.5),
    "clay": partial(_stuff, "clay", minerals.clay, 5, 0.012),
    "leopard": partial(_stuff, "leopard", minerals.leopard, 6, 0.006, sheen=0.3),
    "leather": partial(_stuff, "leather", minerals.leather, 7, 0.010, coat=0.1, coat_roughness=0.3),
    "paint": partial(_stuff, "paint", minerals.flakes, 8, metallic=0.35, coat=1.0),
    "glass": partial(_stuff, "glass", minerals.swirl, 9, coat=1.0, coat_roughness=0.0),
    "wood": _wood,
    "checker": _checker,
    "velvet": _velvet,
}


def board(texels: np.ndarray, centres: Sequence[np.ndarray]) -> Surface:
    x, y = texels[..., 0], texels[..., 1]
    edge = 0.1375  # four squares between two balls
    column, row = np.floor(x / edge + 0.5), np.floor(y / edge + 0.5)
    odd = (column + row) % 2.0
    shift = (np.sin(column * 12.9 + row * 78.2) * 43758.5) % 1.0
    inside = np.stack([x + 3.0 * shift, y - 2.0 * shift, texels[..., 2] + shift], -1)
    turned = inside[..., [1, 0, 2]]
    grain = np.where(odd[..., None] > 0.5, inside, turned)
    light, pores = wood(grain, 20.0, HONEY, 50, axis=0)
    dark = ramp(light.mean(-1), [(0.15, (0.13, 0.07, 0.04)), (0.6, (0.46, 0.29, 0.17))])
    image = mix(unit(light * 1.12 + 0.06), dark, odd) * (0.86 + 0.24 * shift[..., None])
    gap = np.minimum(np.abs((x / edge) % 1.0 - 0.5), np.abs((y / edge) % 1.0 - 0.5)) * edge
    joint = step(gap, 0.0045, 0.002)
    image = mix(image, (0.08, 0.05, 0.03), 0.8 * joint)
    near = np.min([np.hypot(x - p[0], y - p[1]) for p in centres], axis=0)
    inlay = step(np.abs(near - 0.165), 0.012, 0.008)
    image = mix(image, (0.93, 0.88, 0.76), 0.9 * inlay)
    return Surface(
        "board", unit(image), unit(0.6 - 0.3 * joint - 0.2 * pores), 0.003, roughness=0.45, coat=0.15,
        coat_roughness=0.2,
    )  # fmt: skip


def rim() -> Surface:
    h, w = 1280, 64
    p = unroll.of_tube(0.04, 7.2, h, w)
    image, pores = wood(p, 30.0, WALNUT, 60)
    v, u = ((np.arange(h) + 0.5) / h * 96.0)[:, None], ((np.arange(w) + 0.5) / w * 4.0)[None]
    lozenge = step(np.abs(v % 1.0 - 0.5) * 2.0 + np.abs(u % 1.0 - 0.5) * 2.6, 0.7, 0.6)
    image = mix(image, (0.93, 0.85, 0.66), 0.9 * lozenge)
    return Surface(
        "rim", unit(image), unit(0.6 - 0.4 * pores), 0.003, roughness=0.35, coat=0.3, coat_roughness=0.1
    )


def bead(name: str, turns: float) -> Surface:
    h, w = 1024, 48
    rope = np.sqrt(np.abs(2.0 * t.diagonal(h, w, turns, 1) - 1.0))
    image = ramp(rope, [(0.0, (0.30, 0.2, 0.08)), (0.6, (0.78, 0.6, 0.3)), (1.0, (0.98, 0.86, 0.55))])
    return Surface(name, image, rope, 0.006, metallic=0.6, roughness=0.38)


def places() -> dict[str, np.ndarray]:
    """The centre [3] of every ball, by the name of its material."""
    return {
        name: np.array([(column - 1.5) * SPACING, (1 - row) * SPACING, BALL_Z])
        for row, names in enumerate(LAYOUT)
        for column, name in enumerate(names)
    }


def build() -> Scene:
    balls = [_ball(name, place, number) for number, (name, place) in enumerate(places().items())]
    return Scene(
        name="materials",
        parts=(*balls, *_tray()),
        lights=(AreaLight((2.4, -2.8, 4.0), 3.0, 170.0, (1.0, 0.96, 0.89)),),
        sky=Gradient(((0.22, 0.18, 0.16), (0.42, 0.42, 0.44), (0.75, 0.82, 0.95), (1.0, 1.05, 1.15))),
    )


def _ball(name: str, place: np.ndarray, number: int) -> Part:
    arc = [(RADIUS * np.cos(a), RADIUS * np.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, 49)]
    arc[0], arc[-1] = (0.0, -RADIUS), (0.0, RADIUS)
    heading, tilt = 2.4 * number + 0.5, np.radians(38.0 + 9.0 * (number % 4))
    axis = (np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt))
    return part(f"ball_{name}", m.revolve(arc, 80).moved(m.frame(place, axis)), BALLS[name]())


def _tray() -> list[Part]:
    flat, share = TRAY.disc(72)
    middle = np.dstack([flat, np.full(share.shape, BOARD - 0.02)])
    above, below = 0.02 * rounded(share, 30.0), 0.035 * rounded(share, 30.0)
    texels = of_grid(puff_points(middle, above, below), 704, 512)

    def level(points: np.ndarray) -> np.ndarray:
        return np.concatenate([points, np.full((*points.shape[:-1], 1), BOARD - 0.005)], -1)

    edge = moulding(*frames_on(level, TRAY.rim(320, 0.03)), bead_section(0.085, 0.13, 4, 0.12))
    rope = moulding(
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
        part("board", puff(middle, above, below), board(texels, list(places().values()))),
        part("rim", edge, rim()),
        part("rim_bead", rope, bead("rim_bead", 150.0)),
        part("feet", m.join(corners), bead("feet", 8.0)),
        part("rings", m.join(rings), bead("rings", 18.0)),
    ]
