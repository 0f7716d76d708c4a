"""Builds, saves and renders small Blender scenes for the tests of what opens users' files."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from dataset_gen import build
from dataset_gen.cameras import look_at


def new_scene():
    """An empty session with a scene that has no world."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def link(name, data, scene=None, matrix=None):
    obj = bpy.data.objects.new(name, data)
    (scene or bpy.context.scene).collection.objects.link(obj)
    if matrix is not None:
        obj.matrix_world = Matrix(np.asarray(matrix).tolist())
    return obj


def principled(name, **values):
    """A material of one Principled shader with these inputs, underscores for spaces."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    shader = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    for socket, value in values.items():
        shader.inputs[socket.replace("_", " ")].default_value = value
    return material


def mesh_of(name, vertices, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.update()
    return mesh


def tetrahedron(name="tetra", size=1.0):
    """Four vertices, none of them where a symmetry could hide a mistake."""
    vertices = [(0, 0, 0), (size, 0, 0), (0, 2 * size, 0), (0, 0, 3 * size)]
    return mesh_of(name, vertices, [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])


def local_vertices(mesh):
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def evaluated(obj):
    """Vertices [V, 3] in world space as Blender evaluates the object now."""
    shown = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    matrix = np.array(shown.matrix_world)
    return local_vertices(shown.to_mesh()) @ matrix[:3, :3].T + matrix[:3, 3]


def save(tmp_path, name="user.blend", **options):
    path = Path(tmp_path) / name
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False, **options)
    return path


def emission(name, connect):
    """A material that shines with what `connect(tree)` returns: colours without light or noise."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    tree.links.new(connect(tree), shader.inputs["Color"])
    return material


def view_from(position, target=(0.0, 0.0, 0.0)):
    return look_at(np.array(position, float), np.array(target, float))


def render_scene(scene, path, pose, size=32, samples=1):
    """[H, W, 4] linear floats, row 0 at the top, of a scene as it is, seen from a pose."""
    camera = bpy.data.objects.new("test camera", bpy.data.cameras.new("test camera"))
    scene.collection.objects.link(camera)
    camera.matrix_world = Matrix(pose.tolist())
    scene.camera = camera
    return _render(scene, path, size, samples)


def render_stage(stage, path, pose, displacement=None, size=32, samples=1):
    """The same of a stage, its vertices moved by `displacement`, one array per object."""
    if displacement is not None:
        build.move(stage, displacement)
    stage.camera.matrix_world = Matrix(pose.tolist())
    stage.camera.data.angle = 0.6911112070083618
    return _render(stage.scene, path, size, samples)


def _render(scene, path, size, samples):
    render = scene.render
    render.engine, scene.cycles.samples, scene.cycles.seed = "CYCLES", samples, 0
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.filter_width = 0.01
    scene.cycles.transparent_max_bounces = 8
    render.threads_mode, render.threads = "FIXED", 1
    render.resolution_x = render.resolution_y = size
    render.resolution_percentage, render.film_transparent = 100, True
    scene.camera.data.sensor_fit = "HORIZONTAL"
    scene.camera.data.angle = 0.6911112070083618
    if bpy.app.version >= (5, 0, 0):
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode = "RGBA"
    render.filepath = str(path)
    render.use_file_extension = False
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(size * size * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(size, size, 4)[::-1]


def bodies_of(loaded):
    return {body.name: body for body in loaded.bodies}


def assert_same_vertices(body, expected, tolerance=2e-6):
    assert body.vertices.dtype == np.float64
    assert body.vertices.shape == expected.shape
    assert np.abs(body.vertices - expected).max() < tolerance
