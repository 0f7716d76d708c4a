"""From the description of a scene to Blender's data: objects, lights, world, camera. Sets a motion state."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from .cameras import CAMERA_ANGLE_X
from .materials import DISPLACEMENT, data_material, sky, surface_material
from .scene import AreaLight, Part, Scene
from .vibration import Motion, State


@dataclass(frozen=True)
class Stage:
    """A scene inside Blender: handles to what the renderer moves."""

    description: Scene
    motion: Motion
    scene: bpy.types.Scene
    camera: bpy.types.Object
    objects: tuple[bpy.types.Object, ...]  # in the order of description.parts
    data: bpy.types.Material  # of the data passes


def build(description: Scene, fps: float) -> Stage:
    """Empties Blender's session and builds the scene at rest."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = sky(description.sky)
    objects = tuple(_part(part, scene) for part in description.parts)
    for number, light in enumerate(description.lights):
        _area_light(light, number, scene)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.lens_unit = "FOV"
    camera.data.angle = CAMERA_ANGLE_X
    camera.data.clip_start, camera.data.clip_end = 0.01, 100.0
    scene.collection.objects.link(camera)
    scene.camera = camera
    return Stage(description, description.motion(fps), scene, camera, objects, data_material())


def _part(part: Part, scene: bpy.types.Scene) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(part.name)
    count, faces = len(part.mesh.vertices), part.mesh.triangles
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", part.mesh.vertices.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    uv = mesh.uv_layers.new(name="uv")
    uv.data.foreach_set("uv", part.mesh.uv.astype(np.float32).ravel())
    mesh.attributes.new(DISPLACEMENT, "FLOAT_VECTOR", "POINT")
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
    obj.rotation_euler = Vector(light.position).to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(obj)


def set_state(stage: Stage, state: State) -> None:
    """Moves every vertex to rest + displacement and writes the displacement beside it.

    Plain vertex positions, no modifier: what is rendered is the analytic motion rounded to float32.
    """
    for number, (part, obj) in enumerate(zip(stage.description.parts, stage.objects, strict=True)):
        moved = stage.motion.displacement(number, state)
        mesh = obj.data
        mesh.vertices.foreach_set("co", (part.mesh.vertices + moved).astype(np.float32).ravel())
        mesh.attributes[DISPLACEMENT].data.foreach_set("vector", moved.astype(np.float32).ravel())
        mesh.update()
        mesh.update_tag()


def set_view(stage: Stage, camera_to_world: np.ndarray) -> None:
    """Places the camera; [4, 4], OpenGL axes, which are Blender's own."""
    stage.camera.matrix_world = Matrix(camera_to_world.tolist())
