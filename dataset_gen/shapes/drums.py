"""Drums and their hardware: shells, hoops, heads, cymbals; rods, tubes, collars, wing nuts, feet, struts.

A drum lies along its z axis with the playing head at z = 0 and the shell below it.
"""

from dataclasses import dataclass

import numpy as np

from .. import meshes as m
from ..meshes import Mesh, Vector
from . import solids as s

_UP = (0.0, 0.0, 1.0)


def _aside(axis: Vector) -> tuple[float, float, float]:
    return (0.0, 0.0, 1.0) if abs(axis[0]) > 0.7 * np.linalg.norm(axis) else (1.0, 0.0, 0.0)


def rod(start: Vector, end: Vector, radius: float, segments: int = 12) -> Mesh:
    """A solid straight rod."""
    path = np.array([start, end], float)
    return m.sweep(path, m.circle(radius, segments), up=_aside(path[1] - path[0]))


def tube(path: np.ndarray, outer: float, inner: float, segments: int = 14) -> Mesh:
    """A hollow tube along a path [P, 3], open at both ends; radii in scene units."""
    up = _aside(path[1] - path[0])
    outside = m.sweep(path, m.circle(outer, segments), up=up, caps=False)
    inside = m.sweep(path, m.circle(inner, segments), up=up, caps=False)
    first = [mesh.vertices[:segments] for mesh in (outside, inside)]
    last = [mesh.vertices[-segments:] for mesh in (outside, inside)]
    return m.join([outside, s.turned(inside), s.strip(last[0], last[1]), s.strip(first[1], first[0])])


def collar(centre: Vector, radius: float, height: float, axis: Vector = _UP) -> Mesh:
    """A turned ring around a tube, rims bevelled."""
    h, b = height / 2.0, min(0.25 * height, 0.2 * radius)
    outline = [(0.0, -h), (radius - b, -h), (radius, -h + b), (radius, h - b), (radius - b, h), (0.0, h)]
    return m.revolve(outline, 20).moved(m.frame(centre, axis, _aside(axis)))


def wing_nut(centre: Vector, axis: Vector, size: float) -> Mesh:
    """Hub along `axis` with two wings; `size` is the span of the wings."""
    k = size / 2.0
    hub = m.revolve(
        [(0.0, 0.0), (0.34 * k, 0.0), (0.34 * k, 0.25 * k), (0.24 * k, 0.7 * k), (0.0, 0.7 * k)], 14
    )
    angle = np.linspace(0.0, 2 * np.pi, 14, endpoint=False)
    lobe = np.column_stack([0.62 * k + 0.4 * k * np.cos(angle), 0.62 * k + 0.33 * k * np.sin(angle)])
    wing = s.prism(lobe, -0.09 * k, 0.09 * k, 0.02 * k, smooth=True)
    upright = m.frame((0.0, 0.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
    one = wing.moved(upright)
    other = s.turned(Mesh(one.vertices * [-1.0, 1.0, 1.0], one.triangles, one.uv))
    return m.join([hub, one, other]).moved(
        m.frame(centre, axis, _UP if abs(axis[2]) < 0.9 * np.linalg.norm(axis) else _aside(axis))
    )


def rubber_foot(centre: Vector, radius: float) -> Mesh:
    """A ribbed rubber ball with a flat sole at the height of `centre`."""
    outline = [
        (0.0, 0.0), (0.7 * radius, 0.0), (radius, 0.3 * radius), (radius, 0.7 * radius), (0.85 * radius, 0.8 * radius),
        (0.95 * radius, 0.95 * radius), (0.95 * radius, 1.3 * radius), (0.6 * radius, 1.8 * radius),
        (0.0, 1.9 * radius),
    ]  # fmt: skip
    return m.revolve(outline, 16).moved(m.frame(centre, _UP))


def tripod(
    foot: Vector, spread: float, hub: float, heading: float, width: float = 0.014
) -> tuple[Mesh, Mesh]:
    """Metal and rubber of three double-strut legs around the tube that stands above `foot` on the floor.

    Legs reach from `hub` above the floor out to `spread`; `heading` (radians) turns the first leg.
    """
    base = np.asarray(foot, float)
    metal = [
        collar(base + [0, 0, hub], 0.032, 0.055),
        collar(base + [0, 0, 0.3 * hub], 0.029, 0.04),
        wing_nut(base + [0.03 * np.cos(heading + 1.0), 0.03 * np.sin(heading + 1.0), hub],
                 (np.cos(heading + 1.0), np.sin(heading + 1.0), 0.0), 0.06),
    ]  # fmt: skip
    rubber = []
    for angle in heading + 2 * np.pi * np.arange(3) / 3:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        side = np.array([-out[1], out[0], 0.0])
        top, knee = base + 0.03 * out + [0, 0, hub], base + 0.85 * spread * out + [0, 0, 0.17 * hub]
        end = base + spread * out + [0, 0, 0.026]
        middle = top + 0.58 * (knee - top)
        low = base + 0.028 * out + [0, 0, 0.3 * hub]
        section = m.rounded_rectangle(width, 0.3 * width, 0.1 * width, 2)
        for sign in (-1.0, 1.0):
            leg = np.array([top, middle, knee, end]) + sign * 0.011 * side
            metal.append(m.sweep(leg, section, up=out))
            metal.append(m.sweep(np.array([low, middle]) + sign * 0.006 * side, section, up=out))
        for rivet in (middle, knee, top):
            metal.append(rod(rivet - 0.016 * side, rivet + 0.016 * side, 0.005, 8))
        rubber.append(rubber_foot(base + spread * out, 0.023))
    return m.join(metal), m.join(rubber)


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
