"""Many small copies strewn over surfaces: seeds, crumbs, nails."""

from __future__ import annotations

import numpy as np

from ..meshes import Mesh, frame, join, triangle_areas


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
