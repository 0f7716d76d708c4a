"""Hair as geometry: thin four-sided tubes along strands, so that they can be moved like any mesh."""

from collections.abc import Iterator

import bpy
import numpy as np

from ..build import new_mesh

_SIDES = 4
_RADIUS = 0.005  # scene units; of curves that say nothing, as in Cycles


def tubes(points: np.ndarray, radius: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [4P, 3] and quads [F, 4] of open tubes around strands.

    Parameters: `points` [P, 3] of all strands in a row, `radius` [P], `starts` [S + 1], where each begins.
    """
    strand = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    first, last = starts[:-1][strand], starts[1:][strand] - 1
    index = np.arange(len(points))
    along = points[np.minimum(index + 1, last)] - points[np.maximum(index - 1, first)]
    along = along / np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    # One reference direction for a whole strand, across it, keeps its tube from twisting.
    chord = points[starts[1:] - 1] - points[starts[:-1]]
    across = np.eye(3)[np.abs(chord).argmin(1)][strand]
    side = np.cross(along, across)
    side /= np.maximum(np.linalg.norm(side, axis=1), 1e-12)[:, None]
    up = np.cross(side, along)
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    vertices = (points[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    base = _SIDES * index[index < last][:, None]
    k = np.arange(_SIDES)
    after = (k + 1) % _SIDES
    quads = np.stack([base + k, base + after, base + _SIDES + after, base + _SIDES + k], -1)
    return vertices, quads.reshape(-1, 4)


def tube_mesh(name: str, points: np.ndarray, radius: np.ndarray, starts: np.ndarray) -> bpy.types.Mesh | None:
    """The tubes as a mesh; None where there is no strand of two points."""
    vertices, quads = tubes(points, radius, starts)
    if not len(quads):
        return None
    return new_mesh(name, vertices, quads)


def rest_positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """Vertices [V, 3] float64, local."""
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def curves_mesh(curves: bpy.types.Curves) -> bpy.types.Mesh | None:
    """Tubes along hair curves, as thick as their radius attribute says."""
    count = len(curves.points)
    points, radius = np.empty(3 * count, np.float32), np.full(count, _RADIUS, np.float32)
    curves.points.foreach_get("position", points)
    if "radius" in curves.attributes:
        curves.attributes["radius"].data.foreach_get("value", radius)
    starts = np.empty(len(curves.curves) + 1, np.int32)
    curves.curve_offset_data.foreach_get("value", starts)
    return tube_mesh(curves.name, points.reshape(-1, 3).astype(np.float64), radius, starts.astype(np.int64))


def particle_hair(obj: bpy.types.Object) -> Iterator[tuple[str, bpy.types.Mesh, int]]:
    """Name, tubes in the object's coordinates and material slot of every hair system that is rendered.

    Blender gives the points of a hair one by one, to Cycles as to us.
    """
    for modifier in obj.modifiers:
        if modifier.type != "PARTICLE_SYSTEM" or not modifier.show_render:
            continue
        system = modifier.particle_system
        how = system.settings
        if how.type != "HAIR" or how.render_type != "PATH":
            continue
        children, parents = len(system.child_particles), len(system.particles)
        virtual = parents if children and not how.use_parent_particles else 0
        steps = 2**how.render_step + 1
        points = np.array(
            [
                system.co_hair(object=obj, particle_no=i, step=step)
                for i in range(virtual, parents + children)
                for step in range(steps)
            ],
            np.float64,
        ).reshape(-1, 3)
        mesh = tube_mesh(system.name, *_local(obj, points, how, steps))
        if mesh is not None:
            yield system.name, mesh, max(how.material - 1, 0)


def _local(
    obj: bpy.types.Object, points: np.ndarray, how: bpy.types.ParticleSettings, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in the object's coordinates, radii from root to tip (thickness × scale / 2, as Cycles), starts."""
    inverse = np.linalg.pinv(np.array(obj.matrix_world, np.float64))
    local = points @ inverse[:3, :3].T + inverse[:3, 3]
    thickness = 0.5 * how.radius_scale * np.linspace(how.root_radius, how.tip_radius, steps)
    strands = len(points) // steps
    return local, np.tile(thickness, strands), np.arange(strands + 1) * steps
