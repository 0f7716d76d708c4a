"""Nearest points on triangle meshes: deterministic surface samples, and exact point-triangle distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class SurfaceSamples:
    """Points spread over a triangle mesh, each with its triangle and barycentric coordinates."""

    points: np.ndarray  # [S, 3] float64, scene units
    triangles: np.ndarray  # [S, 3] int64, vertex indices
    barycentric: np.ndarray  # [S, 3] float64, sum 1
    tree: cKDTree

    def interpolate(self, values: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Vertex values [..., V, D] at the samples `which` [...samples], barycentric: [..., *samples, D]."""
        return interpolate(values, self.triangles[which], self.barycentric[which])


def interpolate(values: np.ndarray, triangles: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """Vertex values [..., V, D] at points given by triangles and barycentric coordinates, both [*, 3]."""
    return (values[..., triangles, :] * barycentric[..., None]).sum(axis=-2)


def sample_surface(vertices: np.ndarray, faces: np.ndarray, n_samples: int) -> SurfaceSamples:
    """Every vertex, every triangle's centre, and about `n_samples` more points in proportion to area.

    Deterministic: within a triangle the points follow the R2 low-discrepancy sequence (Roberts 2018), folded
    from the square to the triangle. A vertex of no triangle is a degenerate triangle of its own.
    """
    loose = np.setdiff1d(np.arange(len(vertices)), faces)
    faces = np.concatenate([faces.reshape(-1, 3), np.repeat(loose[:, None], 3, axis=1)]).astype(np.int64)
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    share = area / area.sum() if area.sum() > 0 else np.zeros(len(area))
    counts = 1 + np.floor(share * n_samples).astype(np.int64)
    face_of = np.repeat(np.arange(len(faces)), counts)
    nth = np.arange(len(face_of)) - np.repeat(np.cumsum(counts) - counts, counts)
    # One representative corner per vertex: the first place where it is used.
    _, first = np.unique(faces.ravel(), return_index=True)
    face_of = np.concatenate([face_of, first // 3])
    barycentric = np.concatenate([_folded_r2(nth), np.eye(3)[first % 3]])
    triangles = faces[face_of]
    points = interpolate(vertices, triangles, barycentric)
    return SurfaceSamples(points, triangles, barycentric, cKDTree(points))


def _folded_r2(nth: np.ndarray) -> np.ndarray:
    """Barycentric coordinates [n, 3] of the nth point in a triangle; point 0 is the centre."""
    plastic = 1.32471795724474602596  # the root of x³ = x + 1
    u, v = (1 / 3 + nth / plastic) % 1.0, (1 / 3 + nth / plastic**2) % 1.0
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    return np.stack([1.0 - u - v, u, v], axis=1)


def closest_on_triangles(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(barycentric [n, 3], distance [n]) of the point of triangle i [n, 3, 3] closest to point i [n, 3].

    The foot of the perpendicular if it lies inside, else the closest point of the three edges. Degenerate
    triangles are handled by their edges.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    candidates = [_foot(points, a, b, c)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, edge = corners[:, i], corners[:, j] - corners[:, i]
        length2 = (edge * edge).sum(1)
        s = ((points - start) * edge).sum(1) / np.where(length2 > 0, length2, 1.0)
        barycentric = np.zeros((len(points), 3))
        barycentric[:, j] = np.clip(s, 0.0, 1.0)
        barycentric[:, i] = 1.0 - barycentric[:, j]
        candidates.append(barycentric)
    options = np.stack(candidates)  # [4, n, 3]
    distance = np.linalg.norm((options[..., None] * corners).sum(-2) - points, axis=-1)
    inside = (options >= 0).all(-1)
    best = np.where(inside, distance, np.inf).argmin(0)
    rows = np.arange(len(points))
    return options[best, rows], distance[best, rows]


def _foot(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Barycentric coordinates of the perpendicular's foot; all -1 where the triangle has no area."""
    normal = np.cross(b - a, c - a)
    area2 = (normal * normal).sum(1)
    flat = area2 <= 0
    safe = np.where(flat, 1.0, area2)
    v = (np.cross(points - a, c - a) * normal).sum(1) / safe
    w = (np.cross(b - a, points - a) * normal).sum(1) / safe
    return np.where(flat[:, None], -1.0, np.stack([1.0 - v - w, v, w], axis=1))
