"""What ground truth must fulfil, as functions of arrays: each returns errors, and each can be fed a wrong answer."""

from dataclasses import dataclass

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

REACH = 2e-2  # scene units: triangles farther from a point, as the tree sees it, are not looked at


@dataclass(frozen=True)
class Surface:
    """All bodies of a scene as one mesh, in one pose."""

    vertices: np.ndarray  # [V, 3] float64
    triangles: np.ndarray  # [F, 3]
    tree: BVHTree

    @classmethod
    def of(cls, bodies, displacements=None):
        """At rest, or with every body displaced [V, 3]."""
        starts = np.cumsum([0] + [len(body.vertices) for body in bodies[:-1]])
        vertices = np.concatenate([body.vertices for body in bodies])
        if displacements is not None:
            vertices = vertices + np.concatenate(displacements)
        triangles = np.concatenate([b.triangles + s for b, s in zip(bodies, starts, strict=True)])
        tree = BVHTree.FromPolygons(vertices.tolist(), triangles.tolist(), all_triangles=True)
        return cls(vertices, triangles, tree)

    def feet(self, point):
        """Corners [F, 3], barycentric weights [F, 3] and distances [F] of the nearest points of all triangles near [3].

        In float64. The tree only proposes triangles: its own nearest points are float32, and off by up to 1e-3 on
        slivers (the ship's spars).
        """
        faces = [face for _, _, face, _ in self.tree.find_nearest_range(Vector(point), REACH)]
        corners = self.triangles[faces]
        return corners, *_nearest(point, self.vertices[corners])

    def distance(self, points):
        """[P] of points [P, 3] to the surface, scene units; infinity beyond REACH."""
        return np.array([self.feet(point)[2].min(initial=np.inf) for point in points])

    def foot(self, points):
        """Corners [P, 3] and barycentric weights [P, 3] of the surface point nearest to each of [P, 3]."""
        found = [self.feet(point) for point in points]
        best = [int(distances.argmin()) for _, _, distances in found]
        return tuple(np.array([f[k][b] for f, b in zip(found, best, strict=True)]) for k in (0, 1))


def _nearest(point, corners):
    """Weights [F, 3] and distances [F] of the points of triangles [F, 3, 3] that are nearest to [3]."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = point - a
    uu, vv, uv, wu, wv = (np.einsum("fc,fc->f", x, y) for x, y in ((u, u), (v, v), (u, v), (w, u), (w, v)))
    area = uu * vv - uv * uv
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    tried = [np.stack([1 - s - t, s, t], -1)]
    allowed = [(s >= 0) & (t >= 0) & (s + t <= 1)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, j] - corners[:, i]
        share = np.einsum("fc,fc->f", point - corners[:, i], edge) / np.einsum("fc,fc->f", edge, edge)
        weights = np.zeros((len(corners), 3))
        weights[:, j] = np.clip(share, 0.0, 1.0)
        weights[:, i] = 1.0 - weights[:, j]
        tried.append(weights)
        allowed.append(np.ones(len(corners), bool))
    every = np.stack(tried)
    away = np.linalg.norm(np.einsum("kfn,fnc->kfc", every, corners) - point, axis=-1)
    away = np.where(np.stack(allowed), away, np.inf)
    which, face = away.argmin(0), np.arange(len(corners))
    return every[which, face], away[which, face]


def unprojected(depth, camera):
    """World points [P, 3] of the seen pixels of a planar depth map [H, W], row by row, from pose and lens alone."""
    height, width = depth.shape
    row, column = np.nonzero(depth < 1e9)
    focal = 0.5 * width / np.tan(0.5 * camera.angle_x)
    z = depth[row, column].astype(np.float64)
    local = np.column_stack(
        [(column + 0.5 - width / 2) * z / focal, -(row + 0.5 - height / 2) * z / focal, -z]
    )
    return local @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]


def displacement_errors(position, displacement, rest, displacements):
    """[P] differences between the displacement pass and the mode shapes at the material points that pixels see.

    Undone by its displacement, a point seen must lie on the surface at rest: where it does not, the difference is
    its distance from it. Where two parts touch, the point may be of either.
    """
    moves = np.concatenate(displacements)
    errors = np.full(len(position), np.inf)
    for i, (place, moved) in enumerate(zip(position, displacement, strict=True)):
        corners, weights, away = rest.feet(place - moved)
        off = np.abs(np.einsum("fk,fkc->fc", weights, moves[corners]) - moved).max(1)
        errors[i] = np.maximum(off, away).min(initial=np.inf)
    return errors


def expected_flow(
    position,  # [P, 3] of material points now
    displacement,  # [P, 3] of them now
    rest,
    there,  # displacements of every body at the other time
    camera,
    size,
):
    """[P, 2] pixels by which each point lies elsewhere at the other time, y down."""
    corners, weights = rest.foot(position - displacement)
    other = np.einsum("pk,pkc->pc", weights, np.concatenate(there)[corners])
    now, _ = camera.project(position, size, size)
    then, _ = camera.project(position - displacement + other, size, size)
    return then - now
