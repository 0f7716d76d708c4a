"""What a sailing ship hangs from its masts: ropes, shrouds with ratlines, spars, furled sails, flags."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..meshes import Mesh, Vector, circle, frame, join, revolve, sweep
from .patch import patch, tiled

_LAY = 0.06  # scene units of rope per repeat of its texture


def rope(start: Vector, end: Vector, radius: float, sag: float = 0.0, sides: int = 5, spans: int = 6) -> Mesh:
    """A rope between two points that hangs through by `sag` in its middle."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    t = np.linspace(0.0, 1.0, (spans if sag else 1) + 1)[:, None]
    path = a + (b - a) * t - sag * 4.0 * t * (1.0 - t) * np.array([0.0, 0.0, 1.0])
    return line(path, radius, sides)


def line(path: np.ndarray, radius: float, sides: int = 5) -> Mesh:
    """A rope along a path [P, 3]."""
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return tiled(sweep(path, circle(radius, sides), caps=False), 1.0, max(1.0, round(length / _LAY)))


def shrouds(feet: np.ndarray, heads: np.ndarray, radius: float, step: float) -> tuple[Mesh, Mesh]:
    """Ropes from feet [N, 3] to heads [N, 3], and the ratlines across them every `step` of height."""
    tight = join([rope(f, h, radius) for f, h in zip(feet, heads, strict=True)])
    low, high = feet[:, 2].max() + step, heads[:, 2].min() - 1.2 * step
    rungs = []
    for z in np.arange(low, high, step):
        t = ((z - feet[:, 2]) / (heads[:, 2] - feet[:, 2]))[:, None]
        knots = feet + (heads - feet) * t
        middles = (knots[:-1] + knots[1:]) / 2.0 - [0.0, 0.0, 0.1 * step]
        path = np.empty((2 * len(knots) - 1, 3))
        path[0::2], path[1::2] = knots, middles
        rungs.append(line(path, 0.62 * radius, 4))
    return tight, join(rungs)


def deadeyes(feet: np.ndarray, heads: np.ndarray, radius: float) -> Mesh:
    """The round blocks that set up shrouds: two at the foot of each."""
    outline = [(0.0, -0.4), (0.8, -0.4), (1.0, -0.15), (1.0, 0.15), (0.8, 0.4), (0.0, 0.4)]
    eye = revolve([(r * radius, z * radius) for r, z in outline], 10)
    made = []
    for foot, head in zip(feet, heads, strict=True):
        up = (head - foot) / np.linalg.norm(head - foot)
        across = np.cross(up, [1.0, 0.0, 0.0])
        made += [eye.moved(frame(foot + up * k * radius, across, up)) for k in (0.9, 4.2)]
    return join(made)


def spar(
    start: Vector, end: Vector, radii: Sequence[float], sides: int = 14, rings: int = 25, tile: float = 0.5
) -> Mesh:
    """A round timber; `radii` are spread evenly along it and joined smoothly. One texture repeat per `tile`."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    t = np.linspace(0.0, 1.0, rings)
    radius = np.interp(t, np.linspace(0.0, 1.0, len(radii)), radii)
    up = (1.0, 0.0, 0.0) if abs(b[2] - a[2]) > 0.9 * np.linalg.norm(b - a) else (0.0, 0.0, 1.0)
    made = sweep(a + (b - a) * t[:, None], circle(1.0, sides), radius, up=up)
    return tiled(made, 1.0, float(np.linalg.norm(b - a)) / tile)


def furled(
    start: Vector, end: Vector, radius: float, gaskets: int, rng: np.random.Generator, sag: float = 0.0
) -> tuple[Mesh, Mesh]:
    """A sail rolled up between two points, and the gaskets that tie it: (canvas, ties).

    Thick in the middle (the bunt), pinched at each gasket, lumpy between.
    """
    a, b = np.asarray(start, float), np.asarray(end, float)
    rings, sides = 10 * gaskets + 1, 18
    t = np.linspace(0.0, 1.0, rings)
    pinch = np.abs(np.sin(np.pi * (t * gaskets + 0.5))) ** 0.7  # 0 at the middle of each gasket's share
    bunt = 0.42 + 0.58 * np.sin(np.pi * (0.06 + 0.88 * t)) ** 0.8
    scale = radius * bunt * (0.74 + 0.26 * pinch)
    path = a + (b - a) * t[:, None] - sag * (4.0 * t * (1.0 - t))[:, None] * np.array([0.0, 0.0, 1.0])
    lumps = _lumps(rings, sides, rng) * (0.35 + 0.65 * pinch)[:, None]
    canvas = sweep(path, circle(1.0, sides), scale, caps=False)
    points = canvas.vertices.reshape(rings, sides, 3)
    points = path[:, None] + (points - path[:, None]) * (1.0 + 0.22 * lumps)[..., None]
    closed = np.concatenate([path[:1, None].repeat(sides, 1), points, path[-1:, None].repeat(sides, 1)])
    around = np.concatenate([closed, closed[:, :1]], axis=1)
    length = float(np.linalg.norm(b - a))
    uv = np.stack(np.meshgrid(np.linspace(0, 1, sides + 1), np.linspace(0, length / 0.4, rings + 2)), -1)
    ties = []
    for k in range(gaskets):
        i = min(rings - 1, round((k + 0.5) * 10))
        ring = path[i] + (points[i] - path[i]) * 1.06
        ties.append(tiled(sweep(ring, circle(0.0042, 5), up=b - a, closed=True), 1.0, 3.0))
    return patch(around, uv), join(ties)


def _lumps(rings: int, sides: int, rng: np.random.Generator) -> np.ndarray:
    """Smooth bumps on a roll of canvas, [R, S], about ±1."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    along = np.linspace(0.0, 1.0, rings)
    out = np.zeros((rings, sides))
    for _ in range(14):
        folds, turns = rng.integers(1, 6), rng.uniform(2.0, 14.0)
        out += (
            rng.uniform(0.4, 1.0)
            / folds**0.5
            * np.cos(folds * angle[None] + 2.0 * np.pi * (turns * along[:, None] + rng.uniform()))
        )
    return np.asarray(out / np.abs(out).max())


def flag(
    hoist: Vector,
    size: tuple[float, float],
    heading: float,
    waves: float,
    taper: float = 0.0,
    droop: float = 0.1,
) -> Mesh:
    """Bunting that flies from its upper hoist corner towards `heading` (radians) in ripples; u along the fly."""
    fly, height = size
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 60), np.linspace(0.0, 1.0, 14))
    ripple = 0.07 * fly * u**0.8 * np.sin(2.0 * np.pi * (waves * u - 0.25 * v) - 0.6)
    along = fly * u * (0.97 - 0.03 * np.cos(4.0 * np.pi * waves * u))
    drop = (v - 1.0) * height * (1.0 - taper * u) - 0.5 * height * taper * u - droop * fly * u**2
    out, across = (
        np.array([np.cos(heading), np.sin(heading), 0.0]),
        np.array([-np.sin(heading), np.cos(heading), 0]),
    )
    points = np.asarray(hoist, float) + along[..., None] * out + ripple[..., None] * across
    points[..., 2] += drop
    return patch(points)
