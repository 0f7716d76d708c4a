"""Drums and cymbals: shells with hoops, lugs, tension rods and heads; cymbals with bell, bow and edge.

A drum lies along its z axis with the playing head at z = 0 and the shell below it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import meshes as m
from ..meshes import Mesh
from . import solids as s


@dataclass(frozen=True)
class Drum:
    """Sizes in scene units."""

    radius: float
    depth: float
    lugs: int
    wooden_hoops: bool = False  # a bass drum's hoops with claws; else flanged steel


def shell(drum: Drum, tile: float) -> Mesh:
    """The wall; a texture of `tile` scene units repeats a whole number of times around."""
    z = np.linspace(-drum.depth + 0.004, -0.004, 9)
    mesh = m.revolve([(drum.radius, height) for height in z], 96)
    times = max(1.0, np.round(2 * np.pi * drum.radius / tile))
    return Mesh(mesh.vertices, mesh.triangles, mesh.uv * [times, drum.depth / tile])


def head(radius: float, up: bool, rings: int = 24, segments: int = 72) -> Mesh:
    """A skin at z = 0 with its collar; v is along the frame's x axis, and u to the right seen from outside."""
    r = radius * np.linspace(1.0, 0.0, rings + 1)
    outline = [(radius * 1.012, -0.012), (radius * 1.012, -0.004), *((x, 0.0) for x in r)]
    mesh = m.revolve(outline, segments, sharp_deg=80.0)
    flat = 0.5 + 0.5 * mesh.vertices[mesh.triangles][..., [1, 0]] * [-1.0, 1.0] / (1.02 * radius)
    mesh = Mesh(mesh.vertices, mesh.triangles, flat)
    return mesh if up else s.turned(Mesh(mesh.vertices * [1.0, 1.0, -1.0], mesh.triangles, mesh.uv))


def _steel_hoop(radius: float) -> Mesh:
    """A flanged hoop around the head at z = 0: closed ring of a bent section."""
    r = radius
    outline = [
        (r + 0.005, -0.02), (r + 0.03, -0.02), (r + 0.03, -0.014), (r + 0.013, -0.012), (r + 0.013, 0.014),
        (r + 0.022, 0.017), (r + 0.022, 0.023), (r + 0.006, 0.022), (r + 0.005, -0.02),
    ]  # fmt: skip
    return m.revolve(outline, 96)


def _wooden_hoop(radius: float) -> Mesh:
    r = radius
    outline = [
        (r + 0.004, -0.034), (r + 0.03, -0.034), (r + 0.036, -0.028), (r + 0.036, 0.022), (r + 0.03, 0.028),
        (r + 0.012, 0.028), (r + 0.006, 0.022), (r + 0.004, -0.034),
    ]  # fmt: skip
    return m.revolve(outline, 96)


def hoops(drum: Drum) -> Mesh:
    """Both hoops."""
    one = _wooden_hoop(drum.radius) if drum.wooden_hoops else _steel_hoop(drum.radius)
    other = s.mirrored(one, 2)
    return m.join([one, other.moved(m.shift((0.0, 0.0, -drum.depth)))])


def fittings(drum: Drum) -> Mesh:
    """Lugs, tension rods with their square heads, and what holds the hoops: ears, or claws and T-handles."""
    pieces = [_lug(drum, top) for top in (True, False)]
    angles = 2 * np.pi * (np.arange(drum.lugs) + 0.5) / drum.lugs
    column = m.join(pieces)
    return m.join([column.moved(m.frame((0, 0, 0), (0, 0, 1), (np.cos(a), np.sin(a), 0.0))) for a in angles])


def _lug(drum: Drum, top: bool) -> Mesh:
    """One lug with its rod at angle 0, at the upper or lower end of the shell."""
    r, out = drum.radius, drum.radius + 0.026
    inset = min(0.1, 0.36 * drum.depth)
    body = m.sweep(
        np.array([(r - 0.004, 0, -inset), (r + 0.008, 0, -inset), (r + 0.018, 0, -inset), (r + 0.024, 0, -inset)]),
        m.rounded_rectangle(0.068, 0.034, 0.012, 4), np.array([1.0, 1.0, 0.86, 0.5]),
    )  # fmt: skip
    barrel = _turned_rod(0.0105, -inset - 0.01, -inset + 0.046, out)
    reach = 0.03 if drum.wooden_hoops else 0.02
    parts = [body, barrel, _turned_rod(0.0052, -inset + 0.04, reach, out)]
    parts.append(s.block((out - 0.006, -0.006, reach - 0.002), (out + 0.006, 0.006, reach + 0.02), 0.001))
    if drum.wooden_hoops:
        parts.append(s.block((out - 0.024, -0.016, 0.0285), (out + 0.02, 0.016, 0.036), 0.002))
        parts.append(s.block((out + 0.0105, -0.016, -0.01), (out + 0.017, 0.016, 0.033), 0.002))
    else:
        parts.append(_turned_rod(0.011, -0.014, 0.0, out))
    mesh = m.join(parts)
    return mesh if top else s.mirrored(mesh, 2).moved(m.shift((0.0, 0.0, -drum.depth)))


def _turned_rod(radius: float, z0: float, z1: float, x: float) -> Mesh:
    b = 0.15 * radius
    outline = [(0.0, z0), (radius - b, z0), (radius, z0 + b), (radius, z1 - b), (radius - b, z1), (0.0, z1)]
    return m.revolve(outline, 12).moved(m.shift((x, 0.0, 0.0)))


def cymbal(radius: float, bell: float, bow: float, segments: int = 96) -> Mesh:
    """A cymbal whose hole is at the origin and whose edge hangs below; `bell`, `bow`: radius, depth.

    From the middle of the underside to its edge and back on top: v is 0.5 at the edge.
    """
    r = np.concatenate([np.linspace(0.012, bell, 10), np.linspace(bell * 1.08, radius, 30)])
    dome = 0.32 * bell * (1.0 - np.clip(r / bell, 0.0, 1.0) ** 2)
    body = bow * (1.0 - (np.clip((r - bell) / (radius - bell), 0.0, 1.0)) ** 1.7)
    z = dome + body - (0.32 * bell + bow)
    thin = np.interp(r, [0.0, radius], [0.006, 0.0035])
    under, over = np.column_stack([r, z - thin]), np.column_stack([r, z])[::-1]
    return m.revolve(np.vstack([under, over]).tolist(), segments, sharp_deg=60.0)
