"""How a user's .blend file looks once it is opened: lights, exposure, sky, and what cameras see."""

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
    render_stage,
    save,
    tetrahedron,
    view_from,
)

POSE = view_from((3.2, 2.8, 2.5), (0.4, 0.2, 0.6))


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
