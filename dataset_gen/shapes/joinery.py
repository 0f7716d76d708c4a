"""Woodwork of ships and furniture: rows of balusters, gratings, ladders, windows, lanterns, barrels."""

from __future__ import annotations

import numpy as np

from ..meshes import Mesh, Vector, circle, frame, join, revolve, sweep
from .patch import beam, box, shifted, slab

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


def _turned(outline: list[tuple[float, float]], size: tuple[float, float], segments: int) -> Mesh:
    """A turned piece of an outline scaled in radius and height."""
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


def frame_on(point: Vector, outwards: Vector, up: Vector = (0.0, 0.0, 1.0)) -> np.ndarray:
    """[4, 4] at a point of a wall: z looks outwards, x upwards."""
    return frame(point, outwards, up)
