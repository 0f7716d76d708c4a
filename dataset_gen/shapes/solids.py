"""Solids with flat, bevelled faces: blocks, prisms, plates with a hole; and texture coordinates by position.

Every face has its own vertices, so that it is shaded flat although all meshes are rendered smooth; a wall
that shall look round shares them. Volumes are closed and their normals point outwards.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from ..meshes import Mesh, Vector, join


def facets(polygons: Iterable[np.ndarray]) -> Mesh:
    """Flat polygons, each [K, 3] in counter-clockwise order seen from outside, as fans around corner 0."""
    vertices, triangles, start = [], [], 0
    for polygon in polygons:
        k = len(polygon)
        i = np.arange(1, k - 1)
        vertices.append(polygon)
        triangles.append(np.column_stack([np.full(k - 2, start), start + i, start + i + 1]))
        start += k
    return _mesh(np.concatenate(vertices), np.concatenate(triangles))


def _mesh(vertices: np.ndarray, triangles: np.ndarray) -> Mesh:
    return Mesh(vertices, triangles.astype(np.int32), np.zeros((len(triangles), 3, 2)))


def _lift(outline: np.ndarray, z: float) -> np.ndarray:
    return np.column_stack([outline, np.full(len(outline), z)])


def strip(low: np.ndarray, high: np.ndarray, smooth: bool = False, closed: bool = True) -> Mesh:
    """The wall between two matched lines of points [S, 3]; counter-clockwise from above, it faces outwards."""
    n = len(low)
    i = np.arange(n if closed else n - 1)
    j = (i + 1) % n
    if smooth:
        quads = np.concatenate([np.column_stack([i, j, n + j]), np.column_stack([i, n + j, n + i])])
        return _mesh(np.vstack([low, high]), quads)
    k = 4 * np.arange(len(i))
    vertices = np.stack([low[i], low[j], high[j], high[i]], axis=1).reshape(-1, 3)
    quads = np.concatenate([np.column_stack([k, k + 1, k + 2]), np.column_stack([k, k + 2, k + 3])])
    return _mesh(vertices, quads)


def _lid(ring: np.ndarray, up: bool) -> Mesh:
    """A fan around the middle of a ring [S, 3]: fits every outline that its middle sees."""
    n = len(ring)
    i = np.arange(n)
    triangles = np.column_stack([np.full(n, n), i, (i + 1) % n])
    return _mesh(np.vstack([ring, ring.mean(0)]), triangles if up else triangles[:, ::-1])


def shrunk(outline: np.ndarray, inset: float) -> np.ndarray:
    """A counter-clockwise outline [P, 2] with every side moved inwards by `inset`."""
    before, after = outline - np.roll(outline, 1, 0), np.roll(outline, -1, 0) - outline
    before = before / np.linalg.norm(before, axis=1, keepdims=True)
    after = after / np.linalg.norm(after, axis=1, keepdims=True)
    inward = np.column_stack([-before[:, 1] - after[:, 1], before[:, 0] + after[:, 0]])
    scale = inset / (1.0 + (before * after).sum(1, keepdims=True))
    return outline + inward * scale


def prism(outline: np.ndarray, z0: float, z1: float, bevel: float = 0.0, smooth: bool = False) -> Mesh:
    """A counter-clockwise outline [P, 2] from z0 up to z1, both rims cut at 45° by `bevel`."""
    outline = np.asarray(outline, float)
    if bevel <= 0.0:
        low, high = _lift(outline, z0), _lift(outline, z1)
        return join([strip(low, high, smooth), _lid(low, up=False), _lid(high, up=True)])
    inner = shrunk(outline, bevel)
    rings = [
        _lift(inner, z0), _lift(outline, z0 + bevel), _lift(outline, z1 - bevel), _lift(inner, z1),
    ]  # fmt: skip
    walls = [strip(a, b, smooth) for a, b in pairwise(rings)]
    return join([*walls, _lid(rings[0], up=False), _lid(rings[-1], up=True)])


def block(low: Vector, high: Vector, bevel: float = 0.0) -> Mesh:
    """A box between two corners with all twelve edges cut by `bevel`."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    b = bevel
    outline = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    if b > 0.0:
        outline = [
            (x0 + b, y0), (x1 - b, y0), (x1, y0 + b), (x1, y1 - b),
            (x1 - b, y1), (x0 + b, y1), (x0, y1 - b), (x0, y0 + b),
        ]  # fmt: skip
    return prism(np.array(outline, float), z0, z1, b * 0.999)


def pierced(outer: np.ndarray, inner: np.ndarray, z0: float, z1: float, round_outside: bool = False) -> Mesh:
    """A plate with a hole: matched counter-clockwise outlines [S, 2], from z0 up to z1; the hole is round."""
    out_low, out_high = _lift(outer, z0), _lift(outer, z1)
    in_low, in_high = _lift(inner, z0), _lift(inner, z1)
    return join(
        [
            strip(out_low, out_high, round_outside),
            strip(in_high, in_low, True),
            strip(out_high, in_high),
            strip(in_low, out_low),
        ]
    )


def lamella(front: np.ndarray, back: np.ndarray, y0: float, y1: float, bevel: float = 0.0) -> Mesh:
    """A bent plate across y between matched lines [P, 2] of (x, z); its rims at y0 and y1 are cut by `bevel`."""
    middle = 0.5 * (front + back)
    thin = np.linalg.norm(front - back, axis=1, keepdims=True)
    pull = 2.0 * bevel / thin  # how far the rim's lines come together
    outlines = [np.vstack([front, back[::-1]])]
    outlines.insert(0, np.vstack([front + (middle - front) * pull, (back + (middle - back) * pull)[::-1]]))
    rim, full = outlines

    def at(outline: np.ndarray, y: float) -> np.ndarray:
        return np.column_stack([outline[:, 0], np.full(len(outline), y), outline[:, 1]])

    rings = [at(full, y0), at(full, y1)]
    if bevel > 0.0:
        rings = [at(rim, y0), at(full, y0 + bevel), at(full, y1 - bevel), at(rim, y1)]
    n = len(front)
    walls = [strip(b, a) for a, b in pairwise(rings)]
    first, last = rings[0], rings[-1]
    caps = [strip(first[:n], first[n:][::-1], closed=False), strip(last[n:][::-1], last[:n], closed=False)]
    whole = join([*walls, *caps])
    return whole if volume(whole) > 0.0 else turned(whole)


def volume(mesh: Mesh) -> float:
    """Signed volume of a closed mesh, scene units cubed; positive where normals point outwards."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def turned(mesh: Mesh) -> Mesh:
    """The same surface seen from the other side."""
    return Mesh(mesh.vertices, mesh.triangles[:, ::-1].copy(), mesh.uv[:, ::-1].copy())


def mirrored(mesh: Mesh, axis: int = 1) -> Mesh:
    """The mirror image across the plane where coordinate `axis` is 0, normals still outwards."""
    sign = np.ones(3)
    sign[axis] = -1.0
    return turned(Mesh(mesh.vertices * sign, mesh.triangles, mesh.uv))


def copies(mesh: Mesh, offsets: Sequence[Vector] | np.ndarray) -> Mesh:
    """One copy of the mesh at every offset [N, 3]."""
    at = np.asarray(offsets, float)
    n, v = len(at), len(mesh.vertices)
    vertices = (mesh.vertices[None] + at[:, None]).reshape(-1, 3)
    triangles = (mesh.triangles[None] + (v * np.arange(n))[:, None, None]).reshape(-1, 3)
    return Mesh(vertices, triangles.astype(np.int32), np.tile(mesh.uv, (n, 1, 1)))


def cube_mapped(mesh: Mesh, period: float, offset: Sequence[float] = (0.0, 0.0)) -> Mesh:
    """Texture coordinates from positions: each triangle takes the axis it faces most; 1 is `period` units."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normal).argmax(1)
    across = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    uv = np.take_along_axis(corners, np.repeat(across[:, None], 3, 1), axis=2)
    # Opposite and neighbouring sides take different places, or a pattern would run straight through.
    shift = axis[:, None] * np.array([0.37, 0.21]) + np.asarray(offset, float)
    return Mesh(mesh.vertices, mesh.triangles, uv / period + shift[:, None])
