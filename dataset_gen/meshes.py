"""Triangle meshes in numpy: surfaces of revolution and swept sections, texture coordinates per corner."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Vector = Sequence[float] | np.ndarray  # three numbers


@dataclass(frozen=True)
class Mesh:
    """Triangles. Vertices are shared where the surface is smooth and doubled where it has an edge."""

    vertices: np.ndarray  # [V, 3] float64
    triangles: np.ndarray  # [F, 3] int32
    uv: np.ndarray  # [F, 3, 2] float64, one texture coordinate per corner

    def moved(self, matrix: np.ndarray) -> "Mesh":
        """Transformed by a [4, 4] matrix."""
        return Mesh(self.vertices @ matrix[:3, :3].T + matrix[:3, 3], self.triangles, self.uv)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """All meshes as one."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.triangles + s for m, s in zip(meshes, starts, strict=True)]).astype(np.int32),
        np.concatenate([m.uv for m in meshes]),
    )


def shift(by: Vector) -> np.ndarray:
    """Return [4, 4] that moves by a vector."""
    out = np.eye(4)
    out[:3, 3] = by
    return out


def frame(origin: Vector, axis: Vector, up: Vector = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Return [4, 4] whose z axis is `axis` and whose x axis is as close to `up` as it can be."""
    z = np.asarray(axis, float) / np.linalg.norm(axis)
    x = np.asarray(up, float) - np.dot(up, z) * z
    if np.linalg.norm(x) < 1e-6:
        other = np.eye(3)[int(abs(z[0]) > 0.7)]  # x, or y where z lies along x
        x = other - np.dot(other, z) * z
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    out[:3, 3] = origin
    return out


def _grid(points: np.ndarray, u: np.ndarray, v: np.ndarray, closed: bool) -> Mesh:
    """Triangles between neighbouring rings of points [R, S, 3]; u [S + 1], v [R] texture coordinates."""
    rings, segments = points.shape[:2]
    columns = segments if closed else segments - 1
    r, s = np.meshgrid(np.arange(rings - 1), np.arange(columns), indexing="ij")
    r, s = r.ravel(), s.ravel()
    right = (s + 1) % segments
    a, b = r * segments + s, r * segments + right
    c, d = (r + 1) * segments + right, (r + 1) * segments + s
    uv_a, uv_b = np.column_stack([u[s], v[r]]), np.column_stack([u[s + 1], v[r]])
    uv_c, uv_d = np.column_stack([u[s + 1], v[r + 1]]), np.column_stack([u[s], v[r + 1]])
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    uv = np.concatenate([np.stack([uv_a, uv_b, uv_c], 1), np.stack([uv_a, uv_c, uv_d], 1)])
    vertices = points.reshape(-1, 3)
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    keep = area > 1e-12  # a ring of radius zero is a pole: half of its triangles vanish
    return Mesh(vertices, triangles[keep].astype(np.int32), uv[keep])


def _split_corners(outline: np.ndarray, sharp_deg: float) -> list[np.ndarray]:
    """An outline [P, 2] cut where it turns by more than `sharp_deg`."""
    legs = np.diff(outline, axis=0)
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    turn = np.degrees(np.arccos(np.clip((legs[1:] * legs[:-1]).sum(1), -1.0, 1.0)))
    cuts = [0, *(np.flatnonzero(turn > sharp_deg) + 1), len(outline) - 1]
    return [outline[i : j + 1] for i, j in pairwise(cuts)]


def revolve(outline: Sequence[Sequence[float]], segments: int = 48, sharp_deg: float = 35.0) -> Mesh:
    """Surface of revolution about z of an outline of (radius, z).

    With the outline going up, normals point outwards. u is the angle over a full turn, v the length along the
    outline from 0 to 1.
    """
    path = np.asarray(outline, float)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    angles = 2.0 * np.pi * np.arange(segments) / segments
    u = np.linspace(0.0, 1.0, segments + 1)
    pieces, start = [], 0
    for piece in _split_corners(path, sharp_deg):
        radius, z = piece[:, :1], piece[:, 1:]
        ring = np.stack(
            [radius * np.cos(angles), radius * np.sin(angles), np.broadcast_to(z, (len(piece), segments))], -1
        )
        v = lengths[start : start + len(piece)] / lengths[-1]
        pieces.append(_grid(ring, u, v, closed=True))
        start += len(piece) - 1
    return join(pieces)


def circle(radius: float, segments: int) -> np.ndarray:
    """Cross-section [S, 2] for `sweep`."""
    angles = 2.0 * np.pi * np.arange(segments) / segments
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def rounded_rectangle(width: float, height: float, corner: float, per_corner: int = 4) -> np.ndarray:
    """Cross-section [S, 2] for `sweep`, counter-clockwise."""
    turns = np.linspace(0.0, np.pi / 2.0, per_corner)
    points = []
    for quarter, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        centre = np.array([sx * (width / 2.0 - corner), sy * (height / 2.0 - corner)])
        angles = turns + quarter * np.pi / 2.0
        points.append(centre + corner * np.column_stack([np.cos(angles), np.sin(angles)]))
    return np.concatenate(points)


def _transport(path: np.ndarray, up: Vector, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Directions of a section's x and y axes along a path [P, 3], each [P, 3], without twist."""
    steps = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0) if closed else np.gradient(path, axis=0)
    tangents = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    x = frame(path[0], tangents[0], up)[:3, 0]
    normals = []
    for tangent in tangents:
        x = x - np.dot(x, tangent) * tangent
        x /= np.linalg.norm(x)
        normals.append(x)
    first = np.array(normals)
    return first, np.cross(tangents, first)


def sweep(
    path: np.ndarray,  # [P, 3]
    section: np.ndarray,  # [S, 2], counter-clockwise
    scale: np.ndarray | float = 1.0,  # of the section along the path, [P] or a number
    up: Vector = (0.0, 0.0, 1.0),  # direction of the section's x axis at the start
    caps: bool = True,
    closed: bool = False,  # the path returns to its start (caps are then left out)
) -> Mesh:
    """A section moved along a path. u goes around the section, v is the length along the path from 0 to 1."""
    first, second = _transport(path, up, closed)
    size = np.broadcast_to(np.asarray(scale, float), (len(path),))[:, None, None]
    ring = path[:, None] + size * (
        section[None, :, :1] * first[:, None] + section[None, :, 1:] * second[:, None]
    )
    if closed:
        ring = np.concatenate([ring, ring[:1]])
    centres = np.concatenate([path, path[:1]]) if closed else path
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1))])
    around = np.linspace(0.0, 1.0, len(section) + 1)
    side = _grid(ring, around, lengths / lengths[-1], closed=True)
    if closed or not caps:
        return side
    return join([side, _cap(ring[0], path[0], flip=True), _cap(ring[-1], path[-1], flip=False)])


def _cap(ring: np.ndarray, centre: np.ndarray, flip: bool) -> Mesh:
    """A flat lid on a ring of points [S, 3]."""
    n = len(ring)
    i = np.arange(n)
    triangles = np.column_stack([np.full(n, n), i, (i + 1) % n])
    uv = np.full((n, 3, 2), 0.5)
    return Mesh(np.vstack([ring, centre]), (triangles[:, ::-1] if flip else triangles).astype(np.int32), uv)


def spline(points: Sequence[Vector], per_span: int = 16) -> np.ndarray:
    """Catmull–Rom curve through the points, [P, 3], resampled to equal steps."""
    p = np.asarray(points, float)
    p = np.vstack([2 * p[0] - p[1], p, 2 * p[-1] - p[-2]])
    t = np.linspace(0.0, 1.0, per_span, endpoint=False)[:, None]
    spans = []
    for a, b, c, d in zip(p[:-3], p[1:-2], p[2:-1], p[3:], strict=True):
        spans.append(
            0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)
        )
    curve = np.vstack([*spans, p[-2:-1]])
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    even = np.linspace(0.0, lengths[-1], len(curve))
    return np.column_stack([np.interp(even, lengths, curve[:, k]) for k in range(3)])


def triangle_areas(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Areas [F] in scene units squared."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
