"""The colours of points3d.ply: which candidates a camera sees, and what colour they have in its picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from . import points, tree
from .pictures import straight, to_display
from .plan import Shot
from .settings import Settings
from .vibration import Body


class Painter:
    """Writes, per painting shot, which candidates its camera sees with nothing in between, and their colours.

    The points are those of the rest scene, the picture may show a state near it: the difference is below a
    pixel.
    """

    def __init__(self, bodies: Sequence[Body], settings: Settings, root: Path) -> None:
        self._bodies, self._settings, self._root = bodies, settings, root
        self._candidates: points.PointCandidates | None = None
        self._tree: BVHTree | None = None

    def wants(self, shot: Shot) -> bool:
        """Return whether the shot provides colours that are still missing."""
        if not shot.paints or not points.wanted(self._root, self._settings):
            return False
        return not points.view_file(self._root, shot).exists()

    def paint(self, shot: Shot, linear: np.ndarray) -> None:
        """Takes the colours from the picture [H, W, 4], scene-linear, alpha premultiplied."""
        if self._candidates is None:
            self._candidates = points.sample_surfaces(
                self._bodies, self._settings.points, self._settings.seed
            )
        size = self._settings.size
        positions, normals = self._candidates.positions, self._candidates.normals
        to_eye = shot.camera.camera_to_world[:3, 3] - positions
        distance = np.linalg.norm(to_eye, axis=1)
        facing = np.abs((to_eye * normals).sum(1)) / distance
        pixel, depth = shot.camera.project(positions, size, size)
        inside = ((pixel >= 0) & (pixel < size)).all(1)
        index = np.flatnonzero((facing > 0.2) & inside & (depth > 0))
        column, row = np.floor(np.where(inside[:, None], pixel, 0)).astype(int).T
        index = index[linear[row[index], column[index], 3] > 0.5]
        directions = to_eye[index] / distance[index, None]
        index = index[self._unhidden(positions[index], directions, distance[index])]
        colours = to_display(straight(linear)[0][row[index], column[index]])
        with tree.whole(points.view_file(self._root, shot)) as temporary:
            np.savez(temporary, index=index, colour=colours, weight=facing[index] ** 2)

    def _unhidden(self, positions: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray:
        if self._tree is None:
            starts = np.cumsum([0] + [len(body.vertices) for body in self._bodies[:-1]])
            vertices = np.concatenate([body.vertices for body in self._bodies])
            faces = np.concatenate([b.triangles + s for b, s in zip(self._bodies, starts, strict=True)])
            self._tree = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)
        cast = self._tree.ray_cast
        lifted = positions + 1e-3 * directions
        return np.array(
            [
                cast(Vector(p), Vector(d), r)[0] is None
                for p, d, r in zip(lifted.tolist(), directions.tolist(), distance.tolist(), strict=True)
            ],
            bool,
        )
