"""A user's .blend file as a whole: libraries, scenes, instances, settings, units, and what is left out or refused."""

import subprocess
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen import build, render  # noqa: E402
from dataset_gen.errors import GenerateError  # noqa: E402
from dataset_gen.settings import Quality  # noqa: E402
from dataset_gen.sources import open_blend  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    bodies_of,
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

ODD = Matrix.LocRotScale((1.0, -2.0, 0.5), Matrix.Rotation(0.7, 3, "X"), (0.5, 2.0, 1.5))
POSE = view_from((3.2, 2.8, 2.5), (0.4, 0.2, 0.6))
FIVE = bpy.app.version >= (5, 0, 0)


def plain(tree):
    """A colour for `emission`."""
    return tree.nodes.new("ShaderNodeRGB").outputs[0]


def test_objects_of_a_linked_library_are_taken_and_a_lost_library_is_named(tmp_path):
    new_scene()
    obj = link("bolt", tetrahedron())
    obj.data.materials.append(emission("steel", lambda tree: tree.nodes.new("ShaderNodeTexNoise").outputs[0]))
    library = save(tmp_path, "parts.blend")
    new_scene()
    with bpy.data.libraries.load(str(library), link=True) as (source, target):
        target.objects = source.objects
    link("own", tetrahedron())
    bpy.context.scene.collection.objects.link(target.objects[0])
    user = save(tmp_path)
    loaded = open_blend(user)
    assert set(bodies_of(loaded)) == {"own", "bolt"}
    assert not bpy.data.libraries
    assert all(obj.library is None and obj.data.library is None for obj in loaded.stage.objects)
    library.unlink()
    loaded = open_blend(user)
    assert set(bodies_of(loaded)) == {"own"}
    assert any("parts.blend is missing" in line for line in loaded.warnings)


def test_the_sphere_around_the_scene_leaves_a_wide_floor_out(tmp_path):
    new_scene()
    link("part", tetrahedron())
    loaded = open_blend(save(tmp_path, "a.blend"))
    assert np.allclose(loaded.centre, (0.5, 1.0, 1.5))
    assert np.isclose(loaded.radius, np.sqrt(0.25 + 1 + 2.25))
    link("floor", mesh_of("floor", [(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)], [(0, 1, 2, 3)]))
    wide = open_blend(save(tmp_path, "b.blend"))
    assert (wide.centre, wide.radius) == (loaded.centre, loaded.radius)
    assert set(bodies_of(wide)) == {"part", "floor"}
    assert any("without floor" in line for line in wide.warnings)


def test_vertices_that_are_no_places_are_one_line(tmp_path):
    new_scene()
    mesh = tetrahedron()
    mesh.vertices[2].co.y = float("nan")
    link("broken", mesh)
    with pytest.raises(GenerateError, match=r"object broken: vertex 2 lies at \[0\.0, nan, 0\.0\]"):
        open_blend(save(tmp_path))


def test_the_scene_is_the_active_one_or_the_named_one(tmp_path):
    new_scene()
    link("part", tetrahedron())
    other = bpy.data.scenes.new("other")
    link("second", tetrahedron(), other)
    path = save(tmp_path)
    loaded = open_blend(path)
    assert [body.name for body in loaded.bodies] == ["part"]
    assert any("the file also holds other" in line for line in loaded.warnings)
    assert [body.name for body in open_blend(path, scene="other").bodies] == ["second"]
    with pytest.raises(GenerateError, match="holds no scene 'third': there is Scene, other"):
        open_blend(path, scene="third")


def test_opening_is_the_same_in_every_process(tmp_path):
    new_scene()
    for i in range(5):
        obj = link(f"part {i}", tetrahedron(), matrix=Matrix.Translation((i, 0, 0)))
        obj.instance_type = "NONE"
    path = save(tmp_path)
    program = (
        "import sys, hashlib; from pathlib import Path; from dataset_gen.sources import open_blend\n"
        "loaded = open_blend(Path(sys.argv[1]))\n"
        "content = b''.join(b.name.encode() + b.vertices.tobytes() for b in loaded.bodies)\n"
        "print('digest', hashlib.sha256(content).hexdigest())"
    )
    digests = []
    for _ in range(2):
        words = [sys.executable, "-c", program, str(path)]
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        digests.append([line for line in said.splitlines() if line.startswith("digest")])
    assert digests[0]
    assert digests[0] == digests[1]


def test_instances_of_collections_and_of_faces_are_realised(tmp_path):
    new_scene()
    group = bpy.data.collections.new("group")
    group.objects.link(bpy.data.objects.new("chair", tetrahedron()))
    for i in range(2):
        empty = link(f"place {i}", None, matrix=Matrix.Translation((4 * i, 0, 1)))
        empty.instance_type, empty.instance_collection = "COLLECTION", group
    corners = [(0, 8, 0), (1, 8, 0), (1, 9, 0), (0, 9, 0), (3, 8, 0), (3, 9, 0)]
    emitter = link("emitter", mesh_of("quads", corners, [(0, 1, 2, 3), (1, 4, 5, 2)]))
    emitter.instance_type = "FACES"
    emitter.show_instancer_for_render = False
    leaf = link("leaf", tetrahedron("leaf", 0.1))
    leaf.parent = emitter
    bodies = bodies_of(open_blend(save(tmp_path)))
    assert set(bodies) == {"place 0/chair", "place 1/chair", "emitter/leaf"}
    shift = bodies["place 1/chair"].vertices - bodies["place 0/chair"].vertices
    assert np.allclose(shift, (4, 0, 0))
    assert len(bodies["emitter/leaf"].vertices) == 8  # both leaves in one part
    assert len(bodies["emitter/leaf"].triangles) == 8


def test_instances_made_by_geometry_nodes_are_realised(tmp_path):
    new_scene()
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    nodes = tree.nodes
    kinds = ("MeshCube", "InstanceOnPoints", "SetMaterial")
    cube, place, paint = (nodes.new(f"GeometryNode{kind}") for kind in kinds)
    out = nodes.new("NodeGroupOutput")
    tree.links.new(nodes.new("NodeGroupInput").outputs[0], place.inputs["Points"])
    paint.inputs["Material"].default_value = emission("gold", plain)
    tree.links.new(cube.outputs["Mesh"], paint.inputs["Geometry"])
    tree.links.new(paint.outputs["Geometry"], place.inputs["Instance"])
    tree.links.new(place.outputs["Instances"], out.inputs[0])
    obj = link("field", tetrahedron(size=5.0))
    obj.modifiers.new("scatter", "NODES").node_group = tree
    loaded = open_blend(save(tmp_path))
    (body,) = loaded.bodies
    assert body.name == "field/instances"
    mesh = loaded.stage.objects[0].data
    assert {mesh.materials[face.material_index].name for face in mesh.polygons} == {"gold"}
    centres = body.vertices.reshape(4, 8, 3).mean(1)
    assert np.allclose(
        sorted(map(tuple, centres)), sorted([(0, 0, 0), (5, 0, 0), (0, 10, 0), (0, 0, 15)]), atol=1e-5
    )


def test_only_what_renders_is_taken_from_all_view_layers(tmp_path):
    scene = new_scene()
    for name in ("shown", "hidden"):
        link(name, tetrahedron())
    bpy.data.objects["hidden"].hide_render = True
    link("viewport hidden", tetrahedron()).hide_viewport = True
    for name in ("excluded", "other layer"):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        collection.objects.link(bpy.data.objects.new(name, tetrahedron()))
    second = scene.view_layers.new("second")
    for layer in scene.view_layers:
        layer.layer_collection.children["excluded"].exclude = True
    scene.view_layers[0].layer_collection.children["other layer"].exclude = True
    assert not second.layer_collection.children["other layer"].exclude
    loaded = open_blend(save(tmp_path))
    assert set(bodies_of(loaded)) == {"shown", "viewport hidden", "other layer"}
    assert len(loaded.bodies) == 3  # the second layer shows "shown" too
    assert len(loaded.stage.scene.view_layers) == 1


def test_vertex_group_weights_follow_through_modifiers_and_joins(tmp_path):
    new_scene()
    obj = link("tongue", tetrahedron())
    weights = np.array([0.25, 0.0, 1.0, 0.5])
    tip = obj.vertex_groups.new(name="tip ü")
    for index in (0, 2, 3):
        tip.add([index], float(weights[index]), "REPLACE")
    obj.vertex_groups.new(name="nobody")
    array = obj.modifiers.new("twice", "ARRAY")
    array.count = 2
    array.relative_offset_displace = (2, 0, 0)
    link("bare", tetrahedron())
    bodies = bodies_of(open_blend(save(tmp_path)))
    assert list(bodies["tongue"].groups) == ["tip ü", "nobody"]
    assert not bodies["tongue"].groups["nobody"].any()
    assert np.allclose(bodies["tongue"].groups["tip ü"], np.tile(weights, 2))
    assert bodies["bare"].groups == {}


def test_uv_maps_colours_smoothness_and_slots_are_kept(tmp_path):
    new_scene()
    mesh = tetrahedron()
    uv = mesh.uv_layers.new(name="map")
    coordinates = np.arange(24, dtype=np.float32) / 24
    uv.data.foreach_set("uv", coordinates)
    colour = mesh.color_attributes.new("paint", "FLOAT_COLOR", "POINT")
    colour.data.foreach_set("color", np.arange(16, dtype=np.float32) / 16)
    mesh.polygons.foreach_set("use_smooth", [True, False, True, False])
    for name in ("wood", "steel"):
        mesh.materials.append(emission(name, plain))
    mesh.polygons.foreach_set("material_index", [0, 1, 1, 0])
    obj = link("part", mesh, matrix=ODD)
    obj.material_slots[1].link = "OBJECT"
    obj.material_slots[1].material = emission("brass", plain)
    found = open_blend(save(tmp_path)).stage.objects[0].data
    got = np.empty(24, np.float32)
    found.uv_layers["map"].data.foreach_get("uv", got)
    assert np.array_equal(got, coordinates)
    got = np.empty(16, np.float32)
    found.color_attributes["paint"].data.foreach_get("color", got)
    assert np.array_equal(got, np.arange(16, dtype=np.float32) / 16)
    assert [face.use_smooth for face in found.polygons] == [True, False, True, False]
    assert [face.material_index for face in found.polygons] == [0, 1, 1, 0]
    assert [material.name for material in found.materials] == ["wood", "brass"]


def test_what_the_camera_does_not_see_lights_but_is_no_part(tmp_path):
    new_scene()
    link("part", tetrahedron())
    link("reflector", tetrahedron(size=20.0)).visible_camera = False
    link("catcher", tetrahedron(size=30.0)).is_shadow_catcher = True
    loaded = open_blend(save(tmp_path))
    assert [body.name for body in loaded.bodies] == ["part"]
    assert not loaded.stage.scene.objects["reflector"].visible_camera
    assert "catcher" not in loaded.stage.scene.objects
    assert any("shadow catcher or holdout: catcher" in line for line in loaded.warnings)
    assert loaded.radius < 3


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
    setattr(files, "directory" if FIVE else "base_path", str(tmp_path / "written"))
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
    clear = principled("leaf", Alpha=0.5), principled("glass", Transmission_Weight=1.0)
    for i, material in enumerate((*clear, displaced, smoke, principled("stone"))):
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
