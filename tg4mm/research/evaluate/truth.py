"""The exact motion of a scene at arbitrary points: that of the nearest point on its truth's triangle meshes."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tg4mm.capture.truth_file import Truth, TruthObject
from tg4mm.fit.motion.modes import ModalMotion

_N_SAMPLES = 200_000  # surface samples of all objects together
_N_CANDIDATES = 8  # triangles tried for the exact nearest point
_N_PATCH = 24  # samples of the patch whose rotation is fitted
_AT_ONCE = 20_000  # points, so that a large scene fits in memory
_FLAT = 0.05  # of the largest variance: a direction with less has no extent, only the surface's curvature


def exact_motion(truth: Truth, points: np.ndarray) -> ModalMotion:
    """The exact modal motion of `points` [N, 3] (scene units, at rest), e.g. the means of Gaussians.

    A point moves as the nearest point of any object's surface does (piecewise-linear between vertices): its
    displacement is interpolated there. Its rotation is half the curl (the antisymmetric part) of the
    displacement gradient that fits the surrounding samples best, in the sense of least squares. Along the
    normal of a flat patch no sample shows a gradient: there the normal is taken to stay perpendicular to the
    surface (Kirchhoff), so that a plate that tilts by ω turns by ω and not by half of it. Objects that stand
    still give zeros. Raises ValueError for a wrong shape.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points have shape {points.shape}, expected [N, 3]")
    objects = [o for o in truth.objects if len(o.rest)]
    displacement = np.zeros((len(truth.freqs_hz), len(points), 3), dtype=np.complex128)
    rotation = np.zeros_like(displacement)
    surfaces = [sample_surface(o.rest, o.faces, _N_SAMPLES // len(objects)) for o in objects]
    if surfaces and len(points):
        distance = np.stack([s.tree.query(points, workers=-1)[0] for s in surfaces])
        nearest = distance.argmin(0)
        for i, (obj, surface) in enumerate(zip(objects, surfaces, strict=True)):
            mine = np.flatnonzero(nearest == i)
            for part in np.split(mine, range(_AT_ONCE, len(mine), _AT_ONCE)) if obj.modes.any() else ():
                displacement[:, part], rotation[:, part] = _follow(obj, surface, points[part])
    return ModalMotion(
        truth.freqs_hz,
        displacement.astype(np.complex64),
        rotation.astype(np.complex64),
        truth.fps,
        truth.n_timesteps,
        truth.gains,
        truth.magnified,
    )


def _follow(obj: TruthObject, surface: "SurfaceSamples", points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(displacement, rotation) phasors [K, n, 3] of the points of an object's surface nearest to `points`."""
    k = min(_N_CANDIDATES, len(surface.points))
    _, candidates = surface.tree.query(points, k=k, workers=-1)
    triangles = surface.triangles[candidates.reshape(len(points), k)]  # [n, k, 3]
    corners = obj.rest[triangles].reshape(-1, 3, 3)
    barycentric, distance = closest_on_triangles(np.repeat(points, k, 0), corners)
    best = distance.reshape(len(points), k).argmin(1)
    rows = np.arange(len(points))
    foot = triangles[rows, best], barycentric.reshape(len(points), k, 3)[rows, best]
    n_patch = min(_N_PATCH, len(surface.points))
    _, patch = surface.tree.query(interpolate(obj.rest, *foot), k=n_patch, workers=-1)
    patch = patch.reshape(len(points), n_patch)
    rotation = _rotation(surface.points[patch], surface.interpolate(obj.modes, patch))
    return interpolate(obj.modes, *foot), rotation


def _rotation(x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Rotation phasors [K, n, 3] of patches x [n, S, 3] displaced by d [K, n, S, 3]: see `exact_motion`."""
    r, e = x - x.mean(1, keepdims=True), d - d.mean(2, keepdims=True)
    extent, axes = np.linalg.eigh(np.einsum("nsi,nsj->nij", r, r))
    seen = extent > _FLAT * extent[:, -1:]  # [n, 3], directions along which the patch has extent
    inverse = np.einsum("nia,na,nja->nij", axes, np.where(seen, 1.0 / np.where(seen, extent, 1.0), 0.0), axes)
    gradient = np.einsum("knsi,nsl,nlj->knij", e, r, inverse)  # d ≈ d̄ + gradient · r
    along = np.einsum("nia,na,nja->nij", axes, seen.astype(float), axes)
    # What the patch does not show: its normal stays perpendicular, ∂u/∂n = −∇(u · n) along the surface.
    gradient -= np.einsum("nil,knml,nmj->knij", along, gradient, np.eye(3) - along)
    curl = [gradient[..., j, i] - gradient[..., i, j] for i, j in ((1, 2), (2, 0), (0, 1))]
    return 0.5 * np.stack(curl, -1)


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
