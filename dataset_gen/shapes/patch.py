"""Sheets, boxes and mirrored copies: the plain pieces other shapes are put together from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..meshes import Mesh, Vector, frame, join, triangle_areas


def patch(points: np.ndarray, uv: np.ndarray | None = None, flip: bool = False) -> Mesh:
    """A sheet over a grid of points [R, S, 3]; normals along (S axis) × (R axis), or against it with `flip`.

    uv [R, S, 2]; without it u runs from 0 to 1 along S and v along R.
    """
    rows, columns = points.shape[:2]
    if uv is None:
        u, v = np.meshgrid(np.linspace(0.0, 1.0, columns), np.linspace(0.0, 1.0, rows))
        uv = np.stack([u, v], -1)
    r, s = (x.ravel() for x in np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij"))
    a, b = r * columns + s, r * columns + s + 1
    c, d = b + columns, a + columns
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    if flip:
        triangles = triangles[:, ::-1]
    vertices = points.reshape(-1, 3)
    triangles = triangles[triangle_areas(vertices, triangles) > 1e-12]
    return Mesh(vertices, triangles.astype(np.int32), uv.reshape(-1, 2)[triangles])


def box(size: Vector, at: np.ndarray | None = None, tile: float | None = None) -> Mesh:
    """A box about the origin, moved by `at` [4, 4]; each face has its own texture coordinates.

    `tile`: scene units per repeat of the texture, along the face's longer edge; without it 0..1 per face.
    """
    half = np.asarray(size, float) / 2.0
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            points = np.empty((4, 3))
            points[:, axis] = sign * half[axis]
            points[:, i], points[:, j] = corners[:, 0] * half[i], corners[:, 1] * half[j]
            span = np.array([half[i], half[j]]) * 2.0
            uv = (corners + 1.0) / 2.0 * (span / tile if tile else 1.0)
            if span[1] > span[0]:  # u along the longer edge, as the grain runs
                uv = uv[:, ::-1]
            faces.append(patch(points.reshape(2, 2, 3), uv.reshape(2, 2, 2), flip=sign < 0))
    made = join(faces)
    return made if at is None else made.moved(at)


def beam(
    start: Vector, end: Vector, width: float, height: float, up: Vector = (0, 0, 1), tile: float = 0.3
) -> Mesh:
    """A squared timber from start to end; `height` is measured along `up`."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    return box((height, width, float(np.linalg.norm(b - a))), frame((a + b) / 2.0, b - a, up), tile)


def slab(low: Vector, high: Vector, tile: float | None = None) -> Mesh:
    """A box between two corners, edges along the axes."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    at = np.eye(4)
    at[:3, 3] = (a + b) / 2.0
    return box(b - a, at, tile)


def mirrored(mesh: Mesh, axis: int = 1) -> Mesh:
    """The mirror image through the origin's plane across `axis`, normals still outwards."""
    sign = np.ones(3)
    sign[axis] = -1.0
    return Mesh(mesh.vertices * sign, np.ascontiguousarray(mesh.triangles[:, ::-1]), mesh.uv[:, ::-1])


def both(mesh: Mesh) -> Mesh:
    """A mesh and its mirror image across y: port and starboard."""
    return join([mesh, mirrored(mesh)])


def tiled(mesh: Mesh, u: float, v: float) -> Mesh:
    """Texture coordinates multiplied: the picture repeats."""
    return Mesh(mesh.vertices, mesh.triangles, mesh.uv * [u, v])


def shifted(mesh: Mesh, by: Sequence[float] | np.ndarray) -> Mesh:
    """Moved by a vector."""
    return Mesh(mesh.vertices + np.asarray(by, float), mesh.triangles, mesh.uv)
