"""Patches of surfaces, boxes and slabs, mirrored copies; many small copies strewn over surfaces."""

from collections.abc import Sequence

import numpy as np

from ..meshes import Mesh, Vector, frame, join, shift, triangle_areas
from .solids import mirrored


def on_surface(
    mesh: Mesh,
    count: int,
    rng: np.random.Generator,
    apart: float = 0.0,  # least distance between two of them, scene units
    allowed: np.ndarray | None = None,  # [F] weight of every triangle
) -> tuple[np.ndarray, np.ndarray]:
    """Up to `count` random points [N, 3] on a mesh, by area, and their outward normals [N, 3]."""
    weight = triangle_areas(mesh.vertices, mesh.triangles)
    if allowed is not None:
        weight = weight * allowed
    chosen = rng.choice(len(weight), 4 * count, p=weight / weight.sum())
    a, b, c = (mesh.vertices[mesh.triangles[chosen, k]] for k in range(3))
    s, t = rng.random((2, len(chosen), 1))
    s, t = np.where(s + t > 1.0, 1.0 - s, s), np.where(s + t > 1.0, 1.0 - t, t)
    points = a + s * (b - a) + t * (c - a)
    across = np.cross(b - a, c - a)
    kept: list[int] = []
    for i, point in enumerate(points):
        if not kept or (np.linalg.norm(points[kept] - point, axis=1) > apart).all():
            kept.append(i)
        if len(kept) == count:
            break
    return points[kept], across[kept] / np.linalg.norm(across[kept], axis=1, keepdims=True)


def copies(
    template: Mesh,  # its z axis becomes the normal
    points: np.ndarray,  # [N, 3]
    directions: np.ndarray,  # [N, 3] unit
    rng: np.random.Generator,
    sizes: tuple[float, float] = (1.0, 1.0),  # smallest and largest scale
) -> Mesh:
    """The template at every point, turned at random about its normal. All share one texture, each by its own strip."""
    made = []
    for point, direction in zip(points, directions, strict=True):
        heading = rng.standard_normal(3)
        matrix = frame(point, direction, heading)
        matrix[:3, :3] *= rng.uniform(*sizes)
        copy = template.moved(matrix)
        made.append(Mesh(copy.vertices, copy.triangles, copy.uv + [rng.random(), 0.0]))
    return join(made)


def pebbles(
    places: np.ndarray, sizes: np.ndarray, rng: np.random.Generator, rings: int = 7, segments: int = 10
) -> Mesh:
    """N stones at places [N, 3] (their middles) of sizes [N] (half the longest axis)."""
    count = len(places)
    lat = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rings)
    lon = 2.0 * np.pi * np.arange(segments) / segments
    ball = np.stack(
        np.broadcast_arrays(
            np.cos(lat)[:, None] * np.cos(lon),
            np.cos(lat)[:, None] * np.sin(lon),
            np.sin(lat)[:, None] + 0.0 * lon,
        ),
        -1,
    ).reshape(-1, 3)
    dents = rng.normal(size=(count, 6, 3))
    dents /= np.linalg.norm(dents, axis=2, keepdims=True)
    bump = 1.0 - 0.22 * np.maximum(np.einsum("vj,ndj->nvd", ball, dents) - 0.45, 0.0).sum(2)
    axes = np.stack([np.ones(count), rng.uniform(0.65, 0.95, count), rng.uniform(0.45, 0.7, count)], -1)
    points = ball[None] * bump[..., None] * (axes * sizes[:, None])[:, None]
    turn, tilt = rng.uniform(0.0, 2.0 * np.pi, count), rng.normal(0.0, 0.2, count)
    c, s, ct, st = np.cos(turn), np.sin(turn), np.cos(tilt), np.sin(tilt)
    spin = np.stack(
        [
            np.stack([c * ct, -s, c * st], -1),
            np.stack([s * ct, c, s * st], -1),
            np.stack([-st, 0 * s, ct], -1),
        ],
        1,
    )
    vertices = np.einsum("nij,nvj->nvi", spin, points) + places[:, None]
    r, k = (x.ravel() for x in np.meshgrid(np.arange(rings - 1), np.arange(segments), indexing="ij"))
    right = (k + 1) % segments
    a, b, c4, d = r * segments + k, r * segments + right, (r + 1) * segments + right, (r + 1) * segments + k
    low, high = np.column_stack([a, b, c4]), np.column_stack([a, c4, d])
    keep = np.concatenate([low[r > 0], high[r < rings - 2]])
    corner_u = np.stack([k, k + 1, k + 1, k]) / segments
    corner_v = np.stack([r, r, r + 1, r + 1]) / (rings - 1)
    uv = np.stack([corner_u, corner_v], -1)
    uv = np.concatenate(
        [uv[[0, 1, 2]].transpose(1, 0, 2)[r > 0], uv[[0, 2, 3]].transpose(1, 0, 2)[r < rings - 2]]
    )
    piece = rng.uniform(0.0, 1.0, (count, 1, 1, 2))  # the picture repeats
    starts = rings * segments * np.arange(count)[:, None, None]
    triangles = (keep[None] + starts).reshape(-1, 3).astype(np.int32)
    return Mesh(vertices.reshape(-1, 3), triangles, (0.14 * uv[None] + piece).reshape(-1, 3, 2))


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
    return box(b - a, shift((a + b) / 2.0), tile)


def both(mesh: Mesh) -> Mesh:
    """A mesh and its mirror image across y: port and starboard."""
    return join([mesh, mirrored(mesh)])


def tiled(mesh: Mesh, u: float, v: float) -> Mesh:
    """Texture coordinates multiplied: the picture repeats."""
    return Mesh(mesh.vertices, mesh.triangles, mesh.uv * [u, v])


def shifted(mesh: Mesh, by: Sequence[float] | np.ndarray) -> Mesh:
    """Moved by a vector."""
    return Mesh(mesh.vertices + np.asarray(by, float), mesh.triangles, mesh.uv)
