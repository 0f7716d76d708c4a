"""Woodwork of ships and furniture: balusters, gratings, ladders, lanterns, barrels; ropes, masts and sails."""

from collections.abc import Sequence

import numpy as np

from ..meshes import Mesh, Vector, circle, frame, join, revolve, sweep
from .scatter import beam, box, patch, shifted, slab, tiled

_BALUSTER = [
    (0.0, 0.0), (0.30, 0.0), (0.30, 0.10), (0.18, 0.14), (0.22, 0.2), (0.34, 0.34), (0.30, 0.46),
    (0.15, 0.66), (0.14, 0.74), (0.24, 0.8), (0.16, 0.86), (0.28, 0.92), (0.28, 1.0), (0.0, 1.0),
]  # fmt: skip
_BARREL = [
    (0.0, 0.0), (0.34, 0.0), (0.36, 0.03), (0.41, 0.2), (0.435, 0.38), (0.44, 0.5), (0.435, 0.62),
    (0.41, 0.8), (0.36, 0.97), (0.34, 1.0), (0.32, 1.0), (0.32, 0.96), (0.0, 0.96),
]  # fmt: skip
_LANTERN = [
    (0.0, 0.0), (0.14, 0.0), (0.2, 0.06), (0.12, 0.12), (0.3, 0.2), (0.34, 0.24), (0.3, 0.27),
]  # fmt: skip
_LANTERN_ROOF = [
    (0.42, 0.70), (0.46, 0.72), (0.36, 0.80), (0.2, 0.88), (0.16, 0.94), (0.1, 0.97), (0.07, 1.02),
    (0.09, 1.06), (0.05, 1.1), (0.0, 1.12),
]  # fmt: skip
_LAY = 0.06  # scene units of rope per repeat of its texture


def _turned(outline: list[tuple[float, float]], size: tuple[float, float], segments: int) -> Mesh:
    return revolve([(size[0] * r, size[1] * z) for r, z in outline], segments)


def balustrade(path: np.ndarray, height: float, count: int, rail: float = 0.012) -> tuple[Mesh, Mesh]:
    """Turned balusters along a path [P, 3] under a handrail: (balusters, rail)."""
    at = np.linspace(0.0, 1.0, count)
    along = np.linspace(0.0, 1.0, len(path))
    feet = np.column_stack([np.interp(at, along, path[:, k]) for k in range(3)])
    turned = _turned(_BALUSTER, (0.45 * height, height - 0.4 * rail), 8)
    turned = Mesh(turned.vertices * [0.5, 0.5, 1.0], turned.triangles, turned.uv)
    top = path + [0.0, 0.0, height]
    return join([shifted(turned, foot) for foot in feet]), sweep(top, circle(0.6 * rail, 8))


def grating(low: Vector, high: Vector, pitch: float) -> Mesh:
    """A hatch: a coaming frame with a lattice of ledges inside, between two corners of a box."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    rim = 0.9 * pitch
    pieces = [
        slab((a[0], a[1], a[2]), (b[0], a[1] + rim, b[2]), 0.2),
        slab((a[0], b[1] - rim, a[2]), (b[0], b[1], b[2]), 0.2),
        slab((a[0], a[1] + rim, a[2]), (a[0] + rim, b[1] - rim, b[2]), 0.2),
        slab((b[0] - rim, a[1] + rim, a[2]), (b[0], b[1] - rim, b[2]), 0.2),
    ]
    top = b[2] - 0.12 * pitch
    inner0, inner1 = a[:2] + rim, b[:2] - rim
    for axis, lift in ((0, 0.0), (1, -0.04 * pitch)):
        count = max(2, round((inner1[axis] - inner0[axis]) / pitch))
        for c in inner0[axis] + (np.arange(count) + 0.5) * (inner1[axis] - inner0[axis]) / count:
            lo, hi = np.array([*inner0, top - 0.4 * pitch]), np.array([*inner1, top + lift])
            lo[axis], hi[axis] = c - 0.24 * pitch, c + 0.24 * pitch
            pieces.append(slab(lo, hi, 0.2))
    return join(pieces)


def ladder(foot: Vector, head: Vector, width: float, steps: int) -> Mesh:
    """Two strings with treads between foot and head (both the middle of the ladder)."""
    a, b = np.asarray(foot, float), np.asarray(head, float)
    flat = (b - a) * [1.0, 1.0, 0.0]
    across = np.cross([0.0, 0.0, 1.0], flat / np.linalg.norm(flat)) * width / 2.0
    normal = np.cross(b - a, across)
    pieces = [beam(a + k * across, b + k * across, 0.1 * width, 0.22 * width, normal) for k in (-1.0, 1.0)]
    for t in (np.arange(steps) + 0.6) / steps:
        centre = a + (b - a) * t
        pieces.append(beam(centre - 0.95 * across, centre + 0.95 * across, 0.3 * width, 0.07 * width))
    return join(pieces)


def window(at: np.ndarray, width: float, height: float, bars: tuple[int, int]) -> tuple[Mesh, Mesh]:
    """A window whose outside looks along the z axis of `at` (x up): (frame with bars, glass)."""
    edge, depth = 0.14 * width, 0.22 * width
    pieces = []
    for sx, size in ((1, (edge, width, depth)), (-1, (edge, width, depth))):
        pieces.append(shifted(box(size, tile=0.1), [sx * (height - edge) / 2.0, 0.0, 0.0]))
    for sy in (1, -1):
        side = box((height - 2 * edge, edge, 0.94 * depth), tile=0.1)
        pieces.append(shifted(side, [0.0, sy * (width - edge) / 2.0, 0.0]))
    for k in range(1, bars[0]):
        bar = box((height - 2 * edge, 0.35 * edge, 0.6 * depth), tile=0.1)
        pieces.append(shifted(bar, [0.0, (k / bars[0] - 0.5) * (width - 2 * edge), 0.0]))
    for k in range(1, bars[1]):
        bar = box((0.35 * edge, width - 2 * edge, 0.55 * depth), tile=0.1)
        pieces.append(shifted(bar, [(k / bars[1] - 0.5) * (height - 2 * edge), 0.0, 0.0]))
    pane = box((height - 1.5 * edge, width - 1.5 * edge, 0.3 * depth))
    return join(pieces).moved(at), pane.moved(at)


def lantern(at: np.ndarray, height: float) -> tuple[Mesh, Mesh]:
    """A six-sided stern lantern standing along the z axis of `at`: (gilt metal, glass)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    bars = []
    for a in angle:
        low = np.array([0.27 * np.cos(a), 0.27 * np.sin(a), 0.24])
        high = np.array([0.42 * np.cos(a), 0.42 * np.sin(a), 0.73])
        bars.append(sweep(np.linspace(low, high, 3), circle(0.028, 5), up=(1.0, 0.0, 0.1)))
    metal = join([revolve(_LANTERN, 16), revolve(_LANTERN_ROOF, 16), *bars])
    glass = revolve([(0.0, 0.26), (0.24, 0.26), (0.37, 0.715), (0.0, 0.715)], 6)
    size = np.diag([height, height, height, 1.0])
    return metal.moved(at @ size), glass.moved(at @ size)


def barrel(at: np.ndarray, height: float) -> Mesh:
    """A cask standing along the z axis of `at`; staves in the texture."""
    return _turned(_BARREL, (height, height), 20).moved(at)


def wheel(at: np.ndarray, radius: float, spokes: int = 8) -> Mesh:
    """A ship's wheel turning about the z axis of `at`."""
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    pieces = [sweep(k * ring, circle(s * radius, 8), closed=True) for k, s in ((0.72, 0.07), (0.2, 0.1))]
    for a in np.linspace(0.0, 2.0 * np.pi, spokes, endpoint=False):
        out = np.array([np.cos(a), np.sin(a), 0.0]) * radius
        path = np.linspace(0.1 * out, out, 8)
        size = np.array([0.05, 0.05, 0.04, 0.05, 0.06, 0.045, 0.055, 0.03]) * radius
        pieces.append(sweep(path, circle(1.0, 7), size))
    return join(pieces).moved(at)


def cannon(at: np.ndarray, length: float) -> Mesh:
    """A gun barrel whose muzzle points along the z axis of `at`."""
    outline = [
        (0.0, -0.08), (0.035, -0.075), (0.045, -0.05), (0.025, -0.03), (0.09, -0.02), (0.115, 0.0), (0.115, 0.04),
        (0.1, 0.05), (0.095, 0.3), (0.105, 0.31), (0.105, 0.34), (0.085, 0.35), (0.07, 0.86), (0.085, 0.9),
        (0.1, 0.96), (0.095, 1.0), (0.05, 1.0), (0.05, 0.9), (0.0, 0.9),
    ]  # fmt: skip
    return _turned(outline, (length, length), 16).moved(at)


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
