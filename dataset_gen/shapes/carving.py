"""Carved ornament for furniture: leaves, shells with a boss, volutes."""

from __future__ import annotations

import numpy as np

from ..meshes import Mesh, join, revolve
from .sheet import edged, puff, rounded


def leaf(length: float, width: float, thickness: float, curl: float = 0.0, lobes: int = 5) -> Mesh:
    """A closed acanthus leaf in the xy plane from the origin along +y, its face to +z; `curl` lifts the tip."""
    t = 0.5 + 0.5 * edged(25, 0.4)
    c = edged(15, 0.6)
    outline = np.sin(np.pi * np.clip(0.04 + 0.94 * t, 0.0, 1.0)) ** 0.8 * (1.0 - 0.35 * t)
    outline = outline * (1.0 + 0.16 * np.cos(2.0 * np.pi * lobes * t))
    x = 0.5 * width * outline[:, None] * c[None]
    sweepback = 0.10 * length * np.abs(c[None]) ** 1.5 * np.sin(np.pi * t)[:, None]
    y = length * t[:, None] - sweepback
    z = curl * t[:, None] ** 2 - 0.35 * thickness * c[None] ** 2
    middle = np.stack(np.broadcast_arrays(x, y, z), -1)
    ribs = 0.72 + 0.28 * np.cos(2.0 * np.pi * (1.6 * c[None] ** 2 * 2.0 + lobes * t[:, None]))
    vein = 1.0 - 0.5 * np.exp(-((c[None] / 0.09) ** 2))
    above = thickness * rounded(c, 2.2)[None] * rounded(2.0 * t - 1.0, 4.0)[:, None] * ribs * vein
    return puff(middle, above, 0.5 * above)


def shell(radius: float, thickness: float, leaves: int = 7, spread: float = np.pi) -> Mesh:
    """A fan of leaves about +y in the xy plane, with a boss at the origin; its face to +z."""
    made = []
    for k, angle in enumerate(np.linspace(-spread / 2.0, spread / 2.0, leaves)):
        reach = radius * (0.78 + 0.22 * np.cos(1.3 * angle))
        one = leaf(reach, 0.5 * radius, thickness, 0.25 * thickness * (1 + k % 2))
        c, s = np.cos(angle), np.sin(angle)
        turn = np.eye(4)
        turn[:2, :2] = [[c, s], [-s, c]]
        turn[2, 3] = 0.12 * thickness * (k % 2)
        made.append(one.moved(turn))
    boss = [
        (0.0, -0.4),
        (0.9, -0.4),
        (1.0, 0.0),
        (0.85, 0.5),
        (0.62, 0.6),
        (0.5, 0.75),
        (0.3, 1.0),
        (0.0, 1.1),
    ]
    made.append(revolve([(0.24 * radius * r, 1.3 * thickness * z) for r, z in boss], 24))
    return join(made)


def volute(
    centre: tuple[float, float], radius: float, inner: float, turns: float, count: int = 60
) -> np.ndarray:
    """Spiral [count, 2] in the xz plane: starts above the centre towards +x, winds down and inwards."""
    t = np.linspace(0.0, 1.0, count)
    angle, reach = 2.0 * np.pi * turns * t, radius + (inner - radius) * t**0.8
    return np.column_stack([centre[0] + reach * np.sin(angle), centre[1] + reach * np.cos(angle)])
