"""How a user's .blend file looks once it is opened: lights, exposure, sky, cameras, textures."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen import render  # noqa: E402
from dataset_gen.settings import Quality  # noqa: E402
from dataset_gen.sources import open_blend  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    emission,
    link,
    new_scene,
    principled,
    render_scene,
    render_stage,
    save,
    tetrahedron,
    view_from,
)

POSE = view_from((3.2, 2.8, 2.5), (0.4, 0.2, 0.6))
FIVE = bpy.app.version >= (5, 0, 0)
TURNED = Matrix.LocRotScale((0.2, -0.3, 0.1), Matrix.Rotation(0.7, 3, "X"), (0.8, 1.2, 0.6))


def test_lights_stay_where_they_are_and_what_they_are(tmp_path):
    scene = new_scene()
    link("part", tetrahedron())
    data = bpy.data.lights.new("lamp", "SPOT")
    data.energy = 500.0
    parent = link("arm", None, matrix=Matrix.Translation((1, 2, 3)))
    lamp = link("lamp", data)
    lamp.parent = parent
    lamp.location = (0, 0, 2)
    link("off", bpy.data.lights.new("off", "SUN")).hide_render = True
    group = bpy.data.collections.new("group")
    group.objects.link(bpy.data.objects.new("inner", bpy.data.lights.new("inner", "POINT")))
    place = link("place", None, matrix=Matrix.Translation((7, 0, 0)))
    place.instance_type, place.instance_collection = "COLLECTION", group
    data.keyframe_insert("energy", frame=1)
    scene.frame_set(1)
    loaded = open_blend(save(tmp_path))
    lights = {obj.name: obj for obj in loaded.stage.scene.objects if obj.type == "LIGHT"}
    assert set(lights) == {"lamp", "inner"}
    assert np.allclose(lights["lamp"].matrix_world.translation, (1, 2, 5))
    assert np.allclose(lights["inner"].matrix_world.translation, (7, 0, 0))
    assert (lights["lamp"].data.type, lights["lamp"].data.energy) == ("SPOT", 500.0)
    assert lights["lamp"].data.animation_data is None
    assert not any("light" in line for line in loaded.warnings)


@pytest.mark.parametrize("by", ["lamp", "world", "glow"])
def test_the_exposure_of_the_file_is_kept_in_its_lights(tmp_path, by):
    """Four times the light through a quarter of the exposure is the same picture."""
    pictures = []
    for exposure, factor in ((0.0, 1.0), (-2.0, 4.0)):
        scene = new_scene()
        scene.view_settings.exposure = exposure
        mesh = tetrahedron()
        mesh.materials.append(principled("plain", Emission_Strength=0.5 * factor * (by == "glow")))
        link("part", mesh)
        lamp = bpy.data.lights.new("lamp", "SUN")
        lamp.energy = 3.0 * factor * (by == "lamp")
        link("lamp", lamp, matrix=Matrix.Rotation(0.5, 4, "X"))
        scene.world = bpy.data.worlds.new("sky")
        scene.world.use_nodes = True
        tree = scene.world.node_tree
        value = tree.nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = factor * (by == "world")
        background = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBackground")
        background.inputs["Color"].default_value = (0.5, 0.4, 0.3, 1.0)
        tree.links.new(value.outputs[0], background.inputs["Strength"])
        stage = open_blend(save(tmp_path)).stage
        render.configure(stage, Quality(32, 32, samples=1, seed=0, threads=1))
        pictures.append(render_stage(stage, tmp_path / "a.exr", POSE, samples=2))
    assert pictures[0].max() > 0.05
    assert np.allclose(pictures[0], pictures[1], rtol=1e-3, atol=1e-4)


def test_a_scene_without_any_light_gets_a_sky_and_a_glowing_one_does_not(tmp_path):
    new_scene()
    link("part", tetrahedron())
    dark = open_blend(save(tmp_path, "dark.blend"))
    assert any("no light at all" in line for line in dark.warnings)
    picture = render_stage(dark.stage, tmp_path / "a.exr", POSE)
    assert picture[16, 16, :3].min() > 0.05
    new_scene()
    mesh = tetrahedron()
    mesh.materials.append(emission("glow", lambda tree: tree.nodes.new("ShaderNodeRGB").outputs[0]))
    link("part", mesh)
    assert not any("no light" in line for line in open_blend(save(tmp_path, "glow.blend")).warnings)


def test_all_cameras_are_found_and_see_what_they_saw(tmp_path):
    scene = new_scene()
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    link("part", tetrahedron())
    first = link("first", bpy.data.cameras.new("first"), matrix=Matrix.Translation((0, 0, 9)))
    first.data.angle, first.scale = 0.8, (2, 2, 2)
    tall = link("tall", bpy.data.cameras.new("tall"), matrix=view_from((5, 0, 1)))
    tall.data.sensor_fit = "VERTICAL"
    tall.data.sensor_height, tall.data.lens = 24.0, 24.0
    tall.data.shift_x = 0.1
    link("plan", bpy.data.cameras.new("plan")).data.type = "ORTHO"
    scene.camera = tall
    loaded = open_blend(save(tmp_path))
    assert loaded.camera_names == ("tall", "first")
    seen = dict(zip(loaded.camera_names, loaded.cameras, strict=True))
    assert np.allclose(seen["first"].camera_to_world, Matrix.Translation((0, 0, 9)), atol=1e-6)
    assert np.isclose(seen["first"].angle_x, 0.8, atol=1e-6)
    assert np.allclose(seen["tall"].camera_to_world, view_from((5, 0, 1)), atol=1e-6)
    assert np.isclose(seen["tall"].angle_x, 2 * math.atan(0.5 * 1920 / 1080), atol=1e-6)
    assert np.isclose(seen["tall"].shift[0], -0.1 * 1080 / 1920, atol=1e-6)
    assert any("plan are not perspective" in line for line in loaded.warnings)
    assert [obj.name for obj in loaded.stage.scene.objects if obj.type == "CAMERA"] == ["camera"]
    assert loaded.stage.scene.camera == loaded.stage.camera


def test_a_missing_environment_becomes_a_grey_sky_and_missing_textures_plain_grey(tmp_path):
    scene = new_scene()
    mesh = tetrahedron()

    def lost_texture(tree):
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.new("wood", 4, 4)
        node.image.filepath, node.image.source = "//textures/wood.png", "FILE"
        return node.outputs[0]

    mesh.materials.append(emission("paint", lost_texture))
    link("part", mesh)
    scene.world = bpy.data.worlds.new("outdoors")
    scene.world.use_nodes = True
    tree = scene.world.node_tree
    sky = tree.nodes.new("ShaderNodeTexEnvironment")
    sky.image = bpy.data.images.new("sky", 8, 4)
    sky.image.filepath, sky.image.source = "//hdri/forest.exr", "FILE"
    background = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Strength"].default_value = 0.5
    tree.links.new(sky.outputs[0], background.inputs["Color"])
    loaded = open_blend(save(tmp_path))
    assert any("forest.exr is missing: a grey sky" in line for line in loaded.warnings)
    assert any("wood.png is missing: plain grey" in line for line in loaded.warnings)
    loaded.stage.scene.render.film_transparent = False
    picture = render_stage(loaded.stage, tmp_path / "a.exr", POSE)
    assert np.ptp(picture[..., :3], axis=2).max() < 0.02  # no pink anywhere
    loaded.stage.camera.data.angle = 2.0
    scene = loaded.stage.scene
    assert scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value == 0.5
    assert np.isclose(picture[16, 16, 0], 0.5, atol=0.02)  # the neutral texture, shining with strength 1


def test_an_image_of_another_machine_is_found_by_its_name_near_the_file(tmp_path):
    """The original NeRF-synthetic files name their HDRs by absolute paths of their makers' machines."""
    scene = new_scene()
    (tmp_path / "user" / "hdri").mkdir(parents=True)
    real = bpy.data.images.new("real", 8, 4, float_buffer=True)
    real.pixels.foreach_set(np.tile(np.float32([0.2, 0.9, 0.3, 1.0]), 32))
    real.filepath_raw, real.file_format = str(tmp_path / "user" / "hdri" / "Forest.HDR"), "HDR"
    real.save()
    bpy.data.images.remove(real)
    link("part", tetrahedron())
    scene.world = bpy.data.worlds.new("outdoors")
    scene.world.use_nodes = True
    tree = scene.world.node_tree
    sky = tree.nodes.new("ShaderNodeTexEnvironment")
    sky.image = bpy.data.images.new("sky", 8, 4)
    sky.image.filepath, sky.image.source = "C:\\Users\\maker\\hdris\\forest.hdr", "FILE"
    background = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBackground")
    tree.links.new(sky.outputs[0], background.inputs["Color"])
    loaded = open_blend(save(tmp_path / "user"))
    assert loaded.warnings == (
        "images found by their names near the file: Forest.HDR",
        *(line for line in loaded.warnings if "view transform" in line),
    )
    loaded.stage.scene.render.film_transparent = False
    colour = render_stage(loaded.stage, tmp_path / "a.exr", POSE, samples=8)[10:20, 10:20, :3].mean((0, 1))
    assert colour[1] > 2 * colour[0] > 0


@pytest.mark.skipif(FIVE, reason="from 5.0 on every material has nodes")
def test_materials_and_worlds_without_nodes_look_like_their_viewport_colour(tmp_path):
    scene = new_scene()
    mesh = tetrahedron()
    mesh.materials.append(bpy.data.materials.new("old"))
    mesh.materials[0].diffuse_color = (0.7, 0.2, 0.1, 1.0)
    mesh.materials[0].roughness = 0.25
    link("part", mesh)
    scene.world = bpy.data.worlds.new("old")
    scene.world.color = (0.1, 0.2, 0.9)
    loaded = open_blend(save(tmp_path))
    nodes = loaded.stage.objects[0].data.materials[0].node_tree.nodes
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    assert np.allclose(shader.inputs["Base Color"].default_value, (0.7, 0.2, 0.1, 1.0))
    assert np.isclose(shader.inputs["Roughness"].default_value, 0.25)
    loaded.stage.scene.render.film_transparent = False
    picture = render_stage(loaded.stage, tmp_path / "a.exr", POSE)
    loaded.stage.scene.render.film_transparent = False
    background = loaded.stage.scene.world.node_tree.nodes["Background"].inputs["Color"].default_value
    assert np.allclose(background[:3], (0.1, 0.2, 0.9))
    assert not any("sky" in line for line in loaded.warnings)
    assert picture[..., 2].max() > 2 * picture[..., 0].max() > 0


def noise_of(tree, vector=None):
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = 3.0
    if vector is not None:
        tree.links.new(vector, noise.inputs["Vector"])
    return noise.outputs["Color"]


def coordinates(name, reference=None):
    def connect(tree):
        node = tree.nodes.new("ShaderNodeTexCoord")
        node.object = bpy.data.objects[reference] if reference else None
        return noise_of(tree, node.outputs[name])

    return connect


def geometry_position(tree):
    return noise_of(tree, tree.nodes.new("ShaderNodeNewGeometry").outputs["Position"])


def object_info(tree):
    info, join = tree.nodes.new("ShaderNodeObjectInfo"), tree.nodes.new("ShaderNodeVectorMath")
    tree.links.new(info.outputs["Location"], join.inputs[0])
    tree.links.new(info.outputs["Random"], join.inputs[1])
    return join.outputs[0]


def inside_a_group(tree):
    group = bpy.data.node_groups.get("stone") or bpy.data.node_groups.new("stone", "ShaderNodeTree")
    group.interface.new_socket("Colour", in_out="OUTPUT", socket_type="NodeSocketColor")
    group.links.new(coordinates("Object")(group), group.nodes.new("NodeGroupOutput").inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    return node.outputs[0]


def by_uv(tree):
    return noise_of(tree, tree.nodes.new("ShaderNodeUVMap").outputs[0])


def own_attribute(tree):
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = "displacement"
    return node.outputs["Color"]


def textured_scene(connect):
    scene = new_scene()
    link("reference", None, matrix=Matrix.LocRotScale((1, 1, 0), Matrix.Rotation(1, 3, "Z"), (2, 2, 2)))
    mesh = tetrahedron()
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", np.arange(24, dtype=np.float32) / 12)
    mesh.attributes.new("displacement", "FLOAT_COLOR", "POINT").data.foreach_set(
        "color", np.linspace(0, 1, 16, dtype=np.float32)
    )
    mesh.materials.append(emission("paint", connect))
    link("part", mesh, matrix=TURNED)
    return scene


WAYS = {
    "object": coordinates("Object"), "generated": coordinates("Generated"),
    "axes of another object": coordinates("Object", "reference"), "position": geometry_position,
    "object info": object_info, "group": inside_a_group, "nothing linked": noise_of, "uv": by_uv,
    "attribute of our name": own_attribute,
}  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
def test_textures_look_as_in_the_file_and_go_along_with_the_surface(tmp_path, way):
    scene = textured_scene(WAYS[way])
    path = save(tmp_path)
    wanted = render_scene(scene, tmp_path / "file.exr", POSE)
    loaded = open_blend(path)
    got = render_stage(loaded.stage, tmp_path / "stage.exr", POSE)
    covered = (wanted[..., 3] > 0.99) & (got[..., 3] > 0.99)
    assert covered.sum() > 100
    assert np.ptp(wanted[covered][:, :3], axis=0).max() > 0.05 or way == "object info"
    assert wanted[covered][:, :3].max() > 0.05
    assert np.abs(got - wanted)[covered].max() < 2e-3
    shift = np.array([0.37, -0.21, 0.4])
    pose = POSE.copy()
    pose[:3, 3] += shift
    moved = render_stage(loaded.stage, tmp_path / "moved.exr", pose, [np.tile(shift, (4, 1))])
    assert np.abs(moved - got)[covered & (moved[..., 3] > 0.99)].max() < 2e-3


def joined(tree):
    """Everything that differs from instance to instance, in one colour."""
    mix = tree.nodes.new("ShaderNodeVectorMath")
    tree.links.new(object_info(tree), mix.inputs[0])
    tree.links.new(coordinates("Object")(tree), mix.inputs[1])
    return mix.outputs[0]


def test_instances_joined_to_one_part_look_as_they_did_apart(tmp_path):
    scene = new_scene()
    mesh = tetrahedron(size=0.5)
    mesh.normals_split_custom_set([(0.3, 0.4, 0.8)] * 12)
    mesh.materials.append(emission("paint", joined))
    group = bpy.data.collections.new("group")
    for i in range(4):  # the third is mirrored
        scale = (-0.4 if i == 2 else 0.4, 0.4, 0.3 + 0.1 * i)
        place = Matrix.LocRotScale((0.5 * i, 0.3 * i - 0.5, 0.2), Matrix.Rotation(i, 3, "Z"), scale)
        holder = bpy.data.collections.new(f"holder {i}")
        holder.objects.link(leaf := bpy.data.objects.get("leaf") or bpy.data.objects.new("leaf", mesh))
        inner = bpy.data.objects.new(f"inner {i}", None)
        inner.instance_type, inner.instance_collection = "COLLECTION", holder
        inner.matrix_world = place
        group.objects.link(inner)
    empty = link("all", None, matrix=TURNED)
    empty.instance_type, empty.instance_collection = "COLLECTION", group
    assert leaf.users_scene == ()
    path = save(tmp_path)
    wanted = render_scene(scene, tmp_path / "file.exr", POSE, size=64)
    loaded = open_blend(path)
    (body,) = loaded.bodies
    assert (body.name, len(body.vertices)) == ("all/leaf", 16)
    got = render_stage(loaded.stage, tmp_path / "stage.exr", POSE, size=64)
    covered = (wanted[..., 3] > 0.99) & (got[..., 3] > 0.99)
    assert covered.sum() > 60
    assert covered.sum() > 0.97 * (wanted[..., 3] > 0.99).sum()
    assert np.ptp(wanted[covered][:, 0]) > 0.3
    assert np.median(np.abs(got - wanted)[covered].max(1)) < 1e-3
    assert (np.abs(got - wanted)[covered].max(1) < 1e-2).mean() > 0.97
