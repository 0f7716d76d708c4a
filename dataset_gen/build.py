"""Build Blender's objects, materials and lights from the description of a scene."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from . import compat
from .cameras import CAMERA_ANGLE_X, SceneCamera
from .scene import AreaLight, BlenderSky, Environment, Gradient, Part, Scene, Surface

LINEAR = "Linear Rec.709"
DISPLACEMENT = "displacement"  # name of the vertex attribute and of the AOV it feeds


def new_image(name: str, pixels: np.ndarray, space: str) -> bpy.types.Image:
    """An image inside Blender from [H, W] or [H, W, 3], in a colour space; row 0 is v = 0, as Blender stores it.

    8 bits of 0..1, or floats where the space is LINEAR.
    """
    height, width = pixels.shape[:2]
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels if pixels.ndim == 3 else pixels[..., None]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=space == LINEAR)
    image.colorspace_settings.name = space
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image


def _empty_tree(name: str) -> tuple[bpy.types.Material, bpy.types.NodeTree]:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, material.node_tree


def surface_material(surface: Surface) -> bpy.types.Material:
    """Principled shader with the painted pattern and, where there is one, the relief as a bump."""
    material, tree = _empty_tree(surface.name)
    nodes, links = tree.nodes, tree.links
    shader, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    _reflection(tree, shader, surface)
    colour = nodes.new("ShaderNodeTexImage")
    colour.image = new_image(f"{surface.name} colour", surface.colour, "sRGB")
    links.new(colour.outputs["Color"], shader.inputs["Base Color"])
    if surface.relief is not None:
        relief, bump = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeBump")
        relief.image = new_image(f"{surface.name} relief", surface.relief, "Non-Color")
        bump.inputs["Distance"].default_value = surface.relief_depth
        links.new(relief.outputs["Color"], bump.inputs["Height"])
        links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    return material


def _reflection(tree: bpy.types.NodeTree, shader: bpy.types.Node, surface: Surface) -> None:
    for socket, value in (
        ("Metallic", surface.metallic),
        ("Coat Weight", surface.coat),
        ("Coat Roughness", surface.coat_roughness),
        ("Transmission Weight", surface.transmission),
        ("IOR", surface.ior),
        ("Subsurface Weight", surface.subsurface),
        ("Subsurface Scale", surface.subsurface_radius),
        ("Sheen Weight", surface.sheen),
    ):
        shader.inputs[socket].default_value = value
    if isinstance(surface.roughness, np.ndarray):
        rough = tree.nodes.new("ShaderNodeTexImage")
        rough.image = new_image(f"{surface.name} roughness", surface.roughness, "Non-Color")
        tree.links.new(rough.outputs["Color"], shader.inputs["Roughness"])
    else:
        shader.inputs["Roughness"].default_value = surface.roughness


def trees(roots: Iterable[bpy.types.NodeTree | None]) -> list[bpy.types.NodeTree]:
    """The node trees and all groups inside them, each once."""
    found: list[bpy.types.NodeTree] = []
    todo = [tree for tree in roots if tree is not None]
    while todo:
        tree = todo.pop()
        if tree not in found:
            found.append(tree)
            todo += [node.node_tree for node in tree.nodes if getattr(node, "node_tree", None)]
    return found


def data_material() -> bpy.types.Material:
    """Plain surface whose AOV is the displacement: what the truth render puts on everything.

    Without a bump node the Normal pass is the smooth normal of the mesh.
    """
    material, tree = _empty_tree("tg4mm data")
    nodes, links = tree.nodes, tree.links
    # A closure is needed: Cycles averages the Normal pass over closures, and an emission has none.
    shader, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    attribute, aov = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeOutputAOV")
    attribute.attribute_name = DISPLACEMENT
    aov.aov_name = DISPLACEMENT
    links.new(attribute.outputs["Vector"], aov.inputs["Color"])
    return material


def world(sky: Gradient | BlenderSky | Environment) -> bpy.types.World:
    """The world that lights the scene."""
    made = bpy.data.worlds.new("sky")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    if isinstance(sky, Gradient):
        _gradient(tree, background, sky)
        made.cycles.sampling_method = "NONE"  # smooth: no importance map needed
        return made
    background.inputs["Strength"].default_value = sky.strength
    if isinstance(sky, BlenderSky):
        light = tree.nodes.new("ShaderNodeTexSky")
        compat.use_physical_sky(light)
        light.sun_elevation, light.sun_rotation = sky.sun_elevation, sky.sun_rotation
        light.sun_size = sky.sun_size
    else:
        light = tree.nodes.new("ShaderNodeTexEnvironment")
        light.image = new_image("environment", sky.pixels, LINEAR)
    tree.links.new(light.outputs["Color"], background.inputs["Color"])
    return made


def _gradient(tree: bpy.types.NodeTree, background: bpy.types.Node, sky: Gradient) -> None:
    nodes, links = tree.nodes, tree.links
    direction, split = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeSeparateXYZ")
    height, ramp = nodes.new("ShaderNodeMapRange"), nodes.new("ShaderNodeValToRGB")
    height.inputs["From Min"].default_value = -1.0
    stops = ramp.color_ramp.elements
    while len(stops) < len(sky.colours):
        stops.new(0.5)
    for i, rgb in enumerate(sky.colours):
        stops[i].position = i / (len(sky.colours) - 1)
        stops[i].color = (*rgb, 1.0)
    links.new(direction.outputs["Generated"], split.inputs["Vector"])
    links.new(split.outputs["Z"], height.inputs["Value"])
    links.new(height.outputs["Result"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], background.inputs["Color"])


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


def set_view(stage: Stage, camera: SceneCamera) -> None:
    """Places the camera and sets its lens."""
    stage.camera.matrix_world = Matrix(camera.camera_to_world.tolist())
    stage.camera.data.angle = camera.angle_x
    # From the origin's distance, since a scene of the user's own may be of any size.
    reach = max(float(np.linalg.norm(camera.position)), 1.0)
    stage.camera.data.clip_start, stage.camera.data.clip_end = 0.0005 * reach, 25.0 * reach
    # Blender moves the picture, we the principal point; both in image widths (square pictures).
    stage.camera.data.shift_x, stage.camera.data.shift_y = -camera.shift[0], camera.shift[1]
