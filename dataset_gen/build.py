"""From the description of a scene to Blender's data: objects, lights, world, camera. Moves the vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from .cameras import CAMERA_ANGLE_X, Camera
from .materials import DISPLACEMENT, data_material, surface_material, world
from .scene import AreaLight, Part, Scene


@dataclass(frozen=True)
class Stage:
    """A scene inside Blender: handles to what the renderer moves."""

    scene: bpy.types.Scene
    camera: bpy.types.Object
    objects: tuple[bpy.types.Object, ...]  # each a mesh with identity transform: local is world
    rest: tuple[np.ndarray, ...]  # their vertices at rest, [V, 3] float64, scene units
    data: bpy.types.Material  # of the data passes


def build(description: Scene) -> Stage:
    """Empties Blender's session and builds the scene at rest."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = world(description.sky)
    objects = tuple(_part(part, scene) for part in description.parts)
    for number, light in enumerate(description.lights):
        _area_light(light, number, scene)
    return stage_of(scene, objects, tuple(part.mesh.vertices for part in description.parts))


def stage_of(
    scene: bpy.types.Scene, objects: tuple[bpy.types.Object, ...], rest: tuple[np.ndarray, ...]
) -> Stage:
    """A stage of meshes that are already in the scene: adds the camera and what carries the displacement."""
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.lens_unit = "FOV"
    camera.data.angle = CAMERA_ANGLE_X
    scene.collection.objects.link(camera)
    scene.camera = camera
    for obj in objects:
        obj.data.attributes.new(DISPLACEMENT, "FLOAT_VECTOR", "POINT")
    return Stage(scene, camera, objects, rest, data_material())


def new_mesh(name: str, vertices: np.ndarray, faces: np.ndarray) -> bpy.types.Mesh:
    """A mesh inside Blender of vertices [V, 3] and faces [F, n]."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, faces.shape[1], dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def _part(part: Part, scene: bpy.types.Scene) -> bpy.types.Object:
    faces = part.mesh.triangles
    mesh = new_mesh(part.name, part.mesh.vertices, faces)
    uv = mesh.uv_layers.new(name="uv")
    uv.data.foreach_set("uv", part.mesh.uv.astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
    mesh.materials.append(surface_material(part.surface))
    obj = bpy.data.objects.new(part.name, mesh)
    scene.collection.objects.link(obj)
    return obj


def _area_light(light: AreaLight, number: int, scene: bpy.types.Scene) -> None:
    data = bpy.data.lights.new(f"light_{number}", "AREA")
    data.size = light.size
    data.energy = light.power
    data.color = light.colour
    obj = bpy.data.objects.new(data.name, data)
    obj.location = light.position
    obj.rotation_euler = (Vector(light.position) - Vector(light.target)).to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(obj)


def move(stage: Stage, displacements: Sequence[np.ndarray]) -> None:
    """Moves every vertex to rest + displacement [V, 3] and writes the displacement beside it.

    Plain vertex positions, no modifier: what is rendered is the analytic motion rounded to float32.
    """
    for obj, rest, moved in zip(stage.objects, stage.rest, displacements, strict=True):
        mesh = obj.data
        mesh.vertices.foreach_set("co", (rest + moved).astype(np.float32).ravel())
        mesh.attributes[DISPLACEMENT].data.foreach_set("vector", moved.astype(np.float32).ravel())
        mesh.update()
        mesh.update_tag()


def set_view(stage: Stage, camera: Camera) -> None:
    """Places the camera and sets its lens."""
    stage.camera.matrix_world = Matrix(camera.camera_to_world.tolist())
    stage.camera.data.angle = camera.angle_x
    # From the origin's distance, since a scene of the user's own may be of any size.
    reach = max(float(np.linalg.norm(camera.position)), 1.0)
    stage.camera.data.clip_start, stage.camera.data.clip_end = 0.0005 * reach, 25.0 * reach
    # Blender moves the picture, we the principal point; both in image widths (square pictures).
    stage.camera.data.shift_x, stage.camera.data.shift_y = -camera.shift[0], camera.shift[1]
