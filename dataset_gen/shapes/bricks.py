"""Toy bricks in units of one stud pitch: blocks with studs, beams with holes, pins, axles, gears, treads.

A brick is 1.2 high, a plate 0.4, a stud 0.21. `BrickModel` collects them by part and leaves out studs that
lie inside another brick.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from .. import meshes as m
from ..meshes import Mesh, Vector
from . import solids as s

BRICK, PLATE = 1.2, 0.4  # heights, in stud pitches
STUD_HEIGHT = 0.21
ATLAS = 4  # the stud's texture holds ATLAS² tops, each worn in its own way
_GAP = 0.012  # between neighbouring bricks
_BEVEL = 0.045


def stud(cell: int = 0, segments: int = 16) -> Mesh:
    """A bevelled stud on the plane z = 0; its top shows tile `cell` of an ATLAS × ATLAS texture."""
    outline = [(0.3, -0.02), (0.3, 0.175), (0.262, STUD_HEIGHT), (0.0, STUD_HEIGHT)]
    mesh = m.revolve(outline, segments)
    corners = mesh.vertices[mesh.triangles]
    side = np.ptp(corners[..., 2], axis=1) > 0.1
    tile = np.array([cell % ATLAS, cell // ATLAS], float)
    top_uv = 0.5 + corners[..., :2] / 0.64  # the disc fills the tile but for its rim
    # The wall uses a thin frame of the tile: plain plastic.
    wall_uv = np.stack([0.03 + 0.94 * mesh.uv[..., 0], 0.02 + 0.1 * corners[..., 2]], -1)
    uv = np.where(side[:, None, None], wall_uv, top_uv)
    return Mesh(mesh.vertices, mesh.triangles, (tile + uv) / ATLAS)


def _hole_cell(height: float, points: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Matched outlines of a 1 × `height` rectangle and the unit circle, both [points, 2], from a corner on."""
    per_side = points // 4
    t = np.arange(per_side) / per_side - 0.5
    h = height / 2.0
    half = np.full(per_side, 0.5)
    square = np.concatenate(
        [
            np.column_stack([t, -half * height]),
            np.column_stack([half, t * height]),
            np.column_stack([-t, half * height]),
            np.column_stack([-half, -t * height]),
        ]
    )
    corner = np.arctan2(-h, -0.5)
    angles = np.concatenate(
        [np.linspace(a, b, per_side, endpoint=False) for a, b in _quarters(corner, np.arctan2(-h, 0.5))]
    )
    return square, np.column_stack([np.cos(angles), np.sin(angles)])


def _quarters(first: float, second: float) -> list[tuple[float, float]]:
    """Angles of the four corners of a rectangle, as spans; from (−, −) counter-clockwise."""
    return [
        (first, second), (second, -second), (-second, np.pi + second), (np.pi + second, 2 * np.pi + first),
    ]  # fmt: skip


def _end(x0: float, x1: float, height: float) -> Mesh:
    """A solid end of a beam, rims bevelled, as wide as 1."""
    h = height / 2.0
    return s.block((x0, -h, -0.5), (x1, h, 0.5), _BEVEL)


def beam(length: int, height: float = BRICK, width: float = 1.0) -> Mesh:
    """A beam along x from 0 to `length` with a hole at every whole number between; holes run along z.

    It lies around y = 0 (its height) and z = 0 (its width). Each hole has a recess on both faces.
    """
    square, circle = _hole_cell(height - 0.02)
    at = 0.5 * width - _GAP
    deep = at - 0.11
    rings = [
        np.column_stack([r, np.full(len(r), z)])
        for r, z in ((square, at), (0.4 * circle, at), (0.4 * circle, deep), (0.31 * circle, deep))
    ]
    low = [ring * [1.0, 1.0, -1.0] for ring in rings]
    cell = m.join(
        [
            *(s.strip(a, b, smooth=i == 1) for i, (a, b) in enumerate(pairwise(rings))),
            *(s.strip(b, a, smooth=i == 1) for i, (a, b) in enumerate(pairwise(low))),
            s.strip(rings[3], low[3], smooth=True),
        ]
    )
    holes = s.copies(cell, [(x, 0.0, 0.0) for x in range(1, length)])
    h = height / 2.0 - 0.01
    x0, x1 = 0.5, length - 0.5
    skin = s.facets(
        [np.array([(x0, y, z), (x0, y, -z), (x1, y, -z), (x1, y, z)]) for y, z in ((h, -at), (-h, at))]
    )
    ends = [
        m.Mesh(e.vertices * [1.0, (height - 0.02) / height, 2.0 * at], e.triangles, e.uv)
        for e in (_end(_GAP, 0.5, height), _end(length - 0.5, length - _GAP, height))
    ]
    return m.join([holes, skin, *ends])


def pin(length: float = 0.16) -> Mesh:
    """The visible end of a friction pin that sits in a beam's hole: a collar with a hollow, along z."""
    outline = [
        (0.29, -0.12), (0.29, -0.02), (0.385, -0.02), (0.385, length * 0.3), (0.33, length * 0.5),
        (0.33, length), (0.2, length), (0.2, -0.1), (0.0, -0.1),
    ]  # fmt: skip
    return m.revolve(outline, 16)


def axle(length: float, radius: float = 0.29) -> Mesh:
    """An axle of cross section along z, from 0 to `length`."""
    a, b = radius, radius * 0.38
    quarter = np.array([(a, -b), (a, b), (b, b)])
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    outline = np.concatenate([quarter @ np.linalg.matrix_power(turn, k) for k in range(4)])
    return s.prism(outline, 0.0, length)


def bush(radius: float = 0.42, width: float = 0.5) -> Mesh:
    """A bush with a groove, on an axle along z, from 0 to `width`."""
    outline = [
        (0.0, 0.0), (radius * 0.92, 0.0), (radius, 0.04), (radius, width * 0.3), (radius * 0.75, width * 0.36),
        (radius * 0.75, width * 0.64), (radius, width * 0.7), (radius, width - 0.04),
        (radius * 0.92, width), (0.0, width),
    ]  # fmt: skip
    return m.revolve(outline, 20)


def gear(teeth: int, radius: float, width: float, spokes: int = 6, steps: int = 4) -> Mesh:
    """A gear along z, centred on z = 0: toothed rim, `spokes` spokes, hub. `radius` is that of the tips."""
    count = teeth * 2 * steps
    phase = np.arange(count) / count * teeth % 1.0
    depth = 0.13 * radius
    lift = np.clip((np.abs(phase - 0.5) - 0.14) / 0.14, 0.0, 1.0)
    reach = radius - depth * lift
    angle = 2 * np.pi * np.arange(count) / count
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    rim = s.pierced(reach[:, None] * ring, 0.68 * radius * ring, -width / 2, width / 2)
    hub = m.revolve(
        [(0.0, -0.6 * width), (0.3 * radius, -0.6 * width), (0.34 * radius, -0.55 * width),
         (0.34 * radius, 0.55 * width), (0.3 * radius, 0.6 * width), (0.0, 0.6 * width)], 28
    )  # fmt: skip
    arm = s.block(
        (0.2 * radius, -0.1 * radius, -0.3 * width), (0.72 * radius, 0.1 * radius, 0.3 * width), 0.03
    )
    turns = [m.frame((0, 0, 0), (0, 0, 1), (np.cos(a), np.sin(a), 0)) for a in _even(spokes)]
    return m.join([rim, hub, *(arm.moved(t) for t in turns)])


def _even(count: int) -> np.ndarray:
    return 2 * np.pi * np.arange(count) / count


def wheel(radius: float, width: float) -> Mesh:
    """A turned road wheel along z, centred: rim with a groove, dished faces, hub."""
    half = [
        (radius * 0.88, 0.5), (radius * 0.74, 0.46), (radius * 0.66, 0.34), (radius * 0.42, 0.34),
        (radius * 0.34, 0.52), (0.0, 0.52),
    ]  # fmt: skip
    low = [(r, -z * width) for r, z in reversed(half)]
    tread = [
        (radius, -0.44 * width), (radius, -0.15 * width), (radius * 0.86, -0.1 * width),
        (radius * 0.86, 0.1 * width), (radius, 0.15 * width), (radius, 0.44 * width),
    ]  # fmt: skip
    return m.revolve([*low, *tread, *((r, z * width) for r, z in half)], 28, sharp_deg=20.0)


def tread(pitch: float, width: float) -> Mesh:
    """One link of a track: x along it, y across, z outwards, its hinge line at x = ∓pitch/2, z = 0."""
    p, w = pitch, width
    shoe = s.block((-0.44 * p, -w / 2, 0.06), (0.44 * p, w / 2, 0.2), 0.035)
    grouser = s.block((-0.1 * p, -w / 2 + 0.03, 0.19), (0.14 * p, w / 2 - 0.03, 0.44), 0.05)
    guides = [
        s.block((-0.26 * p, y - 0.16, -0.3), (0.26 * p, y + 0.16, 0.08), 0.05) for y in (-0.3 * w, 0.3 * w)
    ]
    knuckle = m.revolve([(0, 0), (0.1, 0), (0.13, 0.03), (0.13, 0.37), (0.1, 0.4), (0, 0.4)], 10)
    across = m.frame((0, 0, 0), (0, 1, 0))
    hinges = [
        knuckle.moved(across).moved(m.shift((x * p, y - 0.2, 0.02)))
        for x, ys in ((-0.5, (-0.42 * w, 0.0, 0.42 * w)), (0.5, (-0.2 * w, 0.2 * w)))
        for y in ys
    ]
    return m.join([shoe, grouser, *guides, *hinges])


class BrickModel:
    """Meshes by part name; bricks put their studs into the part `<name>_studs`."""

    def __init__(self, rng: np.random.Generator, period: float = 8.0) -> None:
        self._rng = rng
        self._period = period  # of the plastic's texture, stud pitches
        self._meshes: dict[str, list[Mesh]] = {}
        self._boxes: list[tuple[np.ndarray, np.ndarray]] = []
        self._studs: dict[str, list[np.ndarray]] = {}

    def add(self, part: str, mesh: Mesh, mapped: bool = False) -> None:
        """Adds a mesh; unless it is `mapped`, it takes a random place of the tiling plastic texture."""
        place = self._rng.random(2)
        self._meshes.setdefault(part, []).append(
            mesh if mapped else s.cube_mapped(mesh, self._period, (place[0], place[1]))
        )

    def brick(self, part: str, corner: Vector, size: Sequence[float], studs: bool = True) -> None:
        """A brick from its low corner, `size` studs long and wide and any height; studs unless covered."""
        low = np.asarray(corner, float)
        high = low + np.asarray(size, float)
        gap = np.array([_GAP, _GAP, 0.0])
        self.add(part, s.block(low + gap, high - gap - [0.0, 0.0, 0.015], _BEVEL))
        self._boxes.append((low, high))
        if studs:
            x, y = np.meshgrid(
                np.arange(low[0] + 0.5, high[0]), np.arange(low[1] + 0.5, high[1]), indexing="ij"
            )
            tops = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high[2] - 0.015)])
            self._studs.setdefault(f"{part}_studs", []).append(tops)

    def parts(self) -> dict[str, Mesh]:
        """All parts, studs among them."""
        out = {name: m.join(meshes) for name, meshes in self._meshes.items()}
        for name, groups in self._studs.items():
            at = self._uncovered(np.concatenate(groups))
            cells = self._rng.integers(0, ATLAS * ATLAS, len(at))
            shapes = [s.copies(stud(c), at[cells == c]) for c in np.unique(cells)]
            out[name] = m.join(shapes)
        return out

    def _uncovered(self, at: np.ndarray) -> np.ndarray:
        inside = np.zeros(len(at), bool)
        probe = at + [0.0, 0.0, 0.12]
        for low, high in self._boxes:
            inside |= ((probe > low - 0.2) & (probe < high + 0.2))[:, :2].all(1) & (
                (probe[:, 2] > low[2]) & (probe[:, 2] < high[2])
            )
        return at[~inside]
