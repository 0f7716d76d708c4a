"""Hardware of stands: rods, hollow tubes, collars, wing nuts, rubber feet, tripods of double struts."""

from __future__ import annotations

import numpy as np

from .. import meshes as m
from ..meshes import Mesh, Vector
from . import solids as s

_UP = (0.0, 0.0, 1.0)


def _aside(axis: Vector) -> tuple[float, float, float]:
    """A coordinate direction far from `axis`."""
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
