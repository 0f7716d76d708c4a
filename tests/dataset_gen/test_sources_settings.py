"""What of a user's .blend file does not reach the picture, and what does: settings, units, odd materials, scripts."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen import build, render  # noqa: E402
from dataset_gen.settings import Quality  # noqa: E402
from dataset_gen.sources import open_blend  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    emission,
    link,
    mesh_of,
    new_scene,
    principled,
    render_stage,
    save,
    tetrahedron,
    view_from,
)

POSE = view_from((3.2, 2.8, 2.5), (0.4, 0.2, 0.6))
FIVE = bpy.app.version >= (5, 0, 0)


def compositor_that_blackens(scene):
    """A compositor whose output is black, and a File Output node that would write a file."""
    if FIVE:
        tree = bpy.data.node_groups.new("composite", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        scene.compositing_node_group = tree
        output = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        output = tree.nodes.new("CompositorNodeComposite")
    colour = tree.nodes.new("CompositorNodeRGB")
    colour.outputs[0].default_value = (0, 0, 0, 1)
    tree.links.new(colour.outputs[0], output.inputs[0])
    return tree.nodes.new("CompositorNodeOutputFile")


def test_render_settings_compositor_and_sequencer_do_not_reach_the_picture(tmp_path):
    scene = new_scene()
    mesh = tetrahedron()

    def red(tree):
        node = tree.nodes.new("ShaderNodeRGB")
        node.outputs[0].default_value = (0.8, 0.1, 0.05, 1)
        return node.outputs[0]

    mesh.materials.append(emission("red", red))
    link("part", mesh)
    files = compositor_that_blackens(scene)
    (tmp_path / "written").mkdir()
    if FIVE:
        files.directory = str(tmp_path / "written")
    else:
        files.base_path = str(tmp_path / "written")
    render_settings = scene.render
    render_settings.resolution_percentage, render_settings.pixel_aspect_x = 25, 2.0
    render_settings.use_border = render_settings.use_crop_to_border = True
    render_settings.border_max_x = render_settings.border_max_y = 0.3
    render_settings.use_motion_blur = render_settings.use_stamp = render_settings.use_multiview = True
    render_settings.use_freestyle = render_settings.use_simplify = True
    render_settings.dither_intensity, render_settings.simplify_subdivision_render = 2.0, 0
    scene.view_settings.exposure, scene.view_settings.gamma = 1.0, 2.0
    scene.view_settings.use_curve_mapping = True
    scene.cycles.use_denoising, scene.cycles.film_exposure = True, 0.5
    scene.sequence_editor_create()
    scene.view_layers[0].use_freestyle = True
    scene.view_layers[0].pass_alpha_threshold = 0.9
    loaded = open_blend(save(tmp_path))
    stage = loaded.stage
    render.configure(stage, Quality(32, 32, samples=1, seed=0, threads=1))
    fresh = stage.scene.render
    assert fresh.resolution_percentage == 100
    assert fresh.pixel_aspect_x == 1.0
    for name in ("border", "motion_blur", "stamp", "multiview", "freestyle", "simplify"):
        assert not getattr(fresh, f"use_{name}")
    assert stage.scene.view_settings.gamma == 1.0
    assert stage.scene.sequence_editor is None
    picture = render_stage(stage, tmp_path / "a.exr", POSE)
    assert picture.shape == (32, 32, 4)
    # Exposure 1 doubles, the film halves: the brightness of the file is kept.
    assert np.allclose(picture[16, 16], (0.8, 0.1, 0.05, 1), atol=1e-3)
    assert not list((tmp_path / "written").iterdir())
    said = [line.removeprefix("left out, ") for line in loaded.warnings if line.startswith("left out, ")]
    assert said == [
        "compositor: RGB" if not FIVE else "compositor: Color",
        "colour management: gamma 2, curves",
        "Freestyle lines",
        "motion blur",
        "stereo views",
        "render region: pictures are whole",
        "Simplify: geometry is at its full detail",
    ]


def test_strips_animation_blur_and_linked_light_are_named(tmp_path):
    scene = new_scene()
    part = link("part", tetrahedron())
    part.keyframe_insert("location", frame=1)
    camera = link("eye", bpy.data.cameras.new("eye"), matrix=POSE)
    camera.data.dof.use_dof = True
    lamp = link("lamp", bpy.data.lights.new("lamp", "POINT"))
    lamp.light_linking.receiver_collection = bpy.data.collections.new("lit")
    scene.sequence_editor_create().strips.new_scene("again", scene, 1, 1)
    scene.frame_set(7)
    said = open_blend(save(tmp_path)).warnings
    for line in (
        "left out, video sequencer: again",
        "left out, depth of field of cameras: eye",
        "left out, light linking of: lamp",
        "left out, animation, at frame 7 all stands still: part",
    ):
        assert line in said


@pytest.mark.parametrize(
    ("system", "length_unit", "scale", "shown", "metres"),
    [
        ("METRIC", "MILLIMETERS", 0.001, ("mm", 1.0), 0.001),
        ("METRIC", "ADAPTIVE", 0.5, ("m", 0.5), 0.5),
        ("IMPERIAL", "INCHES", 0.0254, ("in", 1.0), 0.0254),
        ("NONE", "", 1.0, ("scene units", 1.0), None),
    ],
)
def test_the_unit_is_the_one_that_the_file_shows_and_metres_are_known_where_it_has_one(
    tmp_path, system, length_unit, scale, shown, metres
):
    scene = new_scene()
    link("part", tetrahedron())
    scene.unit_settings.system, scene.unit_settings.scale_length = system, scale
    if length_unit:
        scene.unit_settings.length_unit = length_unit
    found = open_blend(save(tmp_path))
    assert found.own_unit == (shown[0], pytest.approx(shown[1]))
    assert found.unit_scale_m == (metres and pytest.approx(metres))


def test_materials_that_truth_sees_otherwise_are_named(tmp_path):
    new_scene()
    displaced = principled("bark")
    displaced.displacement_method = "BOTH"
    tree = displaced.node_tree
    height = tree.nodes.new("ShaderNodeDisplacement")
    tree.links.new(height.outputs[0], tree.get_output_node("CYCLES").inputs["Displacement"])
    smoke = principled("smoke")
    tree = smoke.node_tree
    output = tree.get_output_node("CYCLES")
    tree.links.remove(output.inputs["Surface"].links[0])
    tree.links.new(tree.nodes.new("ShaderNodeVolumePrincipled").outputs[0], output.inputs["Volume"])
    materials = [
        principled("leaf", Alpha=0.5),
        principled("glass", Transmission_Weight=1.0),
        displaced,
        smoke,
        principled("stone"),
    ]
    for i, material in enumerate(materials):
        mesh = tetrahedron()
        mesh.materials.append(material)
        link(material.name, mesh, matrix=Matrix.Translation((3 * i, 0, 0)))
    loaded = open_blend(save(tmp_path))
    said = "\n".join(loaded.warnings)
    assert "materials leaf: ground truth treats transparent parts" in said
    assert "materials glass: ground truth is that of the glass surface" in said
    assert "materials bark: displacement is rendered as a bump" in said
    assert "materials smoke: volumes are left out" in said
    assert "stone" not in said
    assert {body.name for body in loaded.bodies} == {"leaf", "glass", "bark", "stone"}
    render.configure(loaded.stage, Quality(16, 16, samples=1, seed=0, threads=1))
    assert loaded.stage.scene.cycles.transparent_max_bounces >= 8
    assert loaded.stage.scene.cycles.transmission_bounces >= 4


def test_scripts_in_the_file_never_run_and_scripted_drivers_are_named(tmp_path):
    new_scene()
    trace = tmp_path / "trace"
    text = bpy.data.texts.new("evil.py")
    text.write(f"open({str(trace)!r}, 'w').close()")
    text.use_module = True
    obj = link("part", tetrahedron())
    driver = obj.driver_add("location", 0).driver
    driver.expression = f"len(str(open({str(trace)!r}, 'w'))) * 0.0 + 5.0"
    path = save(tmp_path)
    trace.unlink(missing_ok=True)
    loaded = open_blend(path)
    assert not trace.exists()
    assert any("scripted drivers of part do not run" in line for line in loaded.warnings)
    assert not bpy.data.texts


def test_the_data_passes_of_a_loaded_stage_are_its_motion(tmp_path):
    pytest.importorskip("OpenEXR")
    new_scene()
    quad = mesh_of("quad", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2, 3)])
    quad.attributes.new("displacement", "FLOAT", "FACE")  # a user's attribute of our name
    quad.materials.append(principled("glass", Transmission_Weight=1.0))
    link("quad", quad)
    loaded = open_blend(save(tmp_path))
    stage = loaded.stage
    render.configure(stage, Quality(16, 16, samples=1, seed=0, threads=1))
    moved = np.array([(0.0, 0.0, 0.1)] * 4) + 0.01 * loaded.bodies[0].vertices
    build.move(stage, [moved])
    stage.camera.matrix_world = Matrix(view_from((0.1, 0.2, 4)).tolist())
    render.use_data(stage)
    passes = render.data_passes(stage)
    hit = passes["Depth"] < 1e9
    assert hit.sum() > 50
    rest = passes["Position"][hit] - passes["Displacement"][hit]
    assert np.abs(rest[:, 2]).max() < 1e-5
    assert np.abs(passes["Displacement"][hit] - (np.array([0, 0, 0.1]) + 0.01 * rest)).max() < 1e-5
