"""What ground truth must fulfil, as functions of arrays: each returns errors, and each can be fed a wrong answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from dataset_gen.cameras import Camera
from dataset_gen.vibration import Body


@dataclass(frozen=True)
class Surface:
    """All bodies of a scene as one mesh, in one pose."""

    vertices: np.ndarray  # [V, 3] float64
    triangles: np.ndarray  # [F, 3]
    tree: BVHTree

    @classmethod
    def of(cls, bodies: Sequence[Body], displacements: Sequence[np.ndarray] | None = None) -> Surface:
        """At rest, or with every body displaced [V, 3]."""
        starts = np.cumsum([0] + [len(body.vertices) for body in bodies[:-1]])
        vertices = np.concatenate([body.vertices for body in bodies])
        if displacements is not None:
            vertices = vertices + np.concatenate(displacements)
        triangles = np.concatenate([b.triangles + s for b, s in zip(bodies, starts, strict=True)])
        tree = BVHTree.FromPolygons(vertices.tolist(), triangles.tolist(), all_triangles=True)
        return cls(vertices, triangles, tree)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """[P] of points [P, 3] to the surface, scene units."""
        return np.array([self.tree.find_nearest(Vector(point))[3] for point in points.tolist()])

    def foot(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners [P, 3] and barycentric weights [P, 3] of the surface point nearest to each of [P, 3]."""
        found = [self.tree.find_nearest(Vector(point)) for point in points.tolist()]
        corners = self.triangles[[face for _, _, face, _ in found]]
        a, b, c = (self.vertices[corners[:, k]] for k in range(3))
        rest = np.array([list(place) for place, _, _, _ in found]) - a
        u, v = b - a, c - a
        uu, vv, uv = (u * u).sum(1), (v * v).sum(1), (u * v).sum(1)
        ru, rv = (rest * u).sum(1), (rest * v).sum(1)
        area = uu * vv - uv * uv
        s, t = (ru * vv - rv * uv) / area, (rv * uu - ru * uv) / area
        return corners, np.column_stack([1 - s - t, s, t])


def unprojected(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """World points [P, 3] of the seen pixels of a planar depth map [H, W], row by row, from pose and lens alone."""
    height, width = depth.shape
    row, column = np.nonzero(depth < 1e9)
    focal = 0.5 * width / np.tan(0.5 * camera.angle_x)
    z = depth[row, column].astype(np.float64)
    local = np.column_stack(
        [(column + 0.5 - width / 2) * z / focal, -(row + 0.5 - height / 2) * z / focal, -z]
    )
    return local @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]


def displacement_errors(
    position: np.ndarray, displacement: np.ndarray, rest: Surface, displacements: Sequence[np.ndarray]
) -> np.ndarray:
    """[P] differences between the displacement pass and the mode shapes at the material points that pixels see.

    Undone by its displacement, a point seen must lie on the surface at rest: where it does not, the difference is
    its distance from it.
    """
    home = position - displacement
    corners, weights = rest.foot(home)
    moves = np.concatenate(displacements)
    expected = np.einsum("pk,pkc->pc", weights, moves[corners])
    return np.maximum(np.abs(expected - displacement).max(1), rest.distance(home))


def expected_flow(
    position: np.ndarray,  # [P, 3] of material points now
    displacement: np.ndarray,  # [P, 3] of them now
    rest: Surface,
    there: Sequence[np.ndarray],  # displacements of every body at the other time
    camera: Camera,
    size: int,
) -> np.ndarray:
    """[P, 2] pixels by which each point lies elsewhere at the other time, y down."""
    corners, weights = rest.foot(position - displacement)
    other = np.einsum("pk,pkc->pc", weights, np.concatenate(there)[corners])
    now, _ = camera.project(position, size, size)
    then, _ = camera.project(position - displacement + other, size, size)
    return then - now
