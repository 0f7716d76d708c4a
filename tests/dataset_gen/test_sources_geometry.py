"""What a user's .blend file shows, as plain meshes in world space: the geometry equals the evaluated one."""

import subprocess
import sys
import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen import build  # noqa: E402
from dataset_gen.errors import GenerateError  # noqa: E402
from dataset_gen.sources import open_blend  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    emission,
    evaluated,
    link,
    local_vertices,
    mesh_of,
    new_scene,
    render_stage,
    save,
    tetrahedron,
    view_from,
)

ODD = Matrix.LocRotScale((1.0, -2.0, 0.5), Matrix.Rotation(0.7, 3, "X"), (0.5, 2.0, 1.5))


def bodies_of(loaded):
    return {body.name: body for body in loaded.bodies}


def assert_same_vertices(body, expected, tolerance=2e-6):
    assert body.vertices.dtype == np.float64
    assert body.vertices.shape == expected.shape
    assert np.abs(body.vertices - expected).max() < tolerance


def face_normals(body):
    corners = body.vertices[body.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True), corners.mean(1)


def test_an_object_becomes_a_mesh_in_world_space_with_its_vertices_in_order(tmp_path):
    new_scene()
    obj = link("part", tetrahedron(), matrix=ODD)
    expected = evaluated(obj)
    loaded = open_blend(save(tmp_path))
    (body,) = loaded.bodies
    (moved,) = loaded.stage.objects
    assert body.name == moved.name == "part"
    assert_same_vertices(body, expected)
    assert np.array_equal(loaded.stage.rest[0], body.vertices)
    assert np.array_equal(local_vertices(moved.data), body.vertices)
    assert np.array_equal(np.array(moved.matrix_world), np.eye(4))
    assert body.triangles.dtype == np.int32
    assert np.array_equal(body.follow, np.ones(4))
    normals, centres = face_normals(body)
    assert ((normals * (centres - body.vertices.mean(0))).sum(1) > 0).all()


def test_moving_a_loaded_stage_puts_every_vertex_at_rest_plus_displacement(tmp_path):
    new_scene()
    link("part", tetrahedron(), matrix=ODD)
    loaded = open_blend(save(tmp_path))
    displacement = np.arange(12.0).reshape(4, 3) * 0.01
    build.move(loaded.stage, [displacement])
    mesh = loaded.stage.objects[0].data
    assert np.abs(local_vertices(mesh) - (loaded.bodies[0].vertices + displacement)).max() < 1e-6


@pytest.mark.parametrize("scale", [(-1.0, 2.0, 1.0), (-1.0, -2.0, -0.5)])
def test_mirrored_objects_keep_their_faces_and_custom_normals_outside(tmp_path, scale):
    new_scene()
    mesh = tetrahedron()
    tilted = np.array(
        [(0.0, 0.0, -1.0)] * 3 + [(0.0, -0.8, 0.6)] * 3 + [(0.6, 0.5, 0.6)] * 3 + [(-1.0, 0.1, 0.2)] * 3
    )
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    mesh.normals_split_custom_set(tilted.tolist())
    link("part", mesh, matrix=Matrix.LocRotScale(None, Matrix.Rotation(0.4, 3, "Z"), scale))
    loaded = open_blend(save(tmp_path))
    body, found = loaded.bodies[0], loaded.stage.objects[0].data
    normals, centres = face_normals(body)
    assert ((normals * (centres - body.vertices.mean(0))).sum(1) > 0).all()
    got = np.array([tuple(normal.vector) for normal in found.corner_normals])
    linear = np.array(Matrix.LocRotScale(None, Matrix.Rotation(0.4, 3, "Z"), scale))[:3, :3]
    wanted = tilted @ np.linalg.inv(linear)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    corner_of = {}
    for face in found.polygons:
        for corner in face.loop_indices:
            corner_of[face.index, found.loops[corner].vertex_index] = got[corner]
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    for index, face in enumerate(faces):
        for offset, vertex in enumerate(face):
            assert corner_of[index, vertex] @ wanted[3 * index + offset] > 0.9995


def test_a_flattened_object_stays_flat(tmp_path):
    new_scene()
    obj = link("flat", tetrahedron(), matrix=Matrix.LocRotScale((0, 0, 1), None, (1, 1, 0)))
    expected = evaluated(obj)
    loaded = open_blend(save(tmp_path))
    assert_same_vertices(loaded.bodies[0], expected)
    assert set(loaded.bodies[0].vertices[:, 2]) == {1.0}


def test_modifiers_are_applied_with_their_render_settings(tmp_path):
    new_scene()
    obj = link("ball", tetrahedron(), matrix=ODD)
    subdivision = obj.modifiers.new("subdivision", "SUBSURF")
    subdivision.levels, subdivision.render_levels = 0, 3
    hidden = obj.modifiers.new("viewport only", "ARRAY")
    hidden.show_render = False
    path = save(tmp_path)
    subdivision.levels, hidden.show_viewport = 3, False
    expected = evaluated(obj)
    bpy.context.scene.render.use_simplify = True
    bpy.context.scene.render.simplify_subdivision_render = 0
    assert_same_vertices(bodies_of(open_blend(path))["ball"], expected)


def test_shape_keys_armatures_constraints_and_animation_are_frozen_at_the_frame(tmp_path):
    scene = new_scene()
    obj = link("bent", tetrahedron())
    obj.shape_key_add(name="rest")
    key = obj.shape_key_add(name="pulled")
    key.data[3].co = (4.0, 0.0, 3.0)
    for frame, value in ((1, 0.0), (11, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    rig = link("rig", bpy.data.armatures.new("rig"))
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones.new("bone")
    bone.head, bone.tail = (0, 0, 0), (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    obj.vertex_groups.new(name="bone").add([0, 1, 2, 3], 1.0, "REPLACE")
    obj.modifiers.new("armature", "ARMATURE").object = rig
    rig.pose.bones["bone"].location = (0.3, 0.2, 0.1)
    target = link("target", None, matrix=Matrix.Translation((0, 5, 0)))
    obj.constraints.new("COPY_LOCATION").target = target
    scene.frame_set(6)
    expected = evaluated(obj)
    path = save(tmp_path)
    loaded = open_blend(path)
    assert_same_vertices(loaded.bodies[0], expected)
    scene, moved = loaded.stage.scene, loaded.stage.objects[0]
    assert moved.data.shape_keys is None
    assert not moved.modifiers
    assert not moved.constraints
    assert moved.animation_data is None
    assert not bpy.data.actions
    scene.frame_set(11)
    assert_same_vertices(loaded.bodies[0], evaluated(moved))
    pulled = open_blend(path, frame=11).bodies[0].vertices
    assert np.abs(pulled[3] - expected[3]).max() > 0.5


def test_curves_surfaces_texts_and_metaballs_become_meshes(tmp_path):
    new_scene()
    bpy.ops.curve.primitive_bezier_circle_add(location=(3, 0, 0))
    bpy.context.object.data.bevel_depth = 0.2
    bpy.context.object.data.materials.append(
        emission("wire", lambda tree: tree.nodes.new("ShaderNodeRGB").outputs[0])
    )
    bpy.ops.surface.primitive_nurbs_surface_sphere_add(location=(0, 3, 0))
    bpy.ops.object.text_add(location=(-3, 0, 0))
    bpy.context.object.data.extrude = 0.1
    bpy.ops.object.metaball_add(type="BALL", location=(0, -3, 0))
    bpy.ops.object.metaball_add(type="BALL", location=(0, -4, 0))  # of the same family
    names = {obj.name for obj in bpy.data.objects if "." not in obj.name}
    circle = next(obj for obj in bpy.data.objects if obj.type == "CURVE")
    expected, name = evaluated(circle), circle.name
    loaded = open_blend(save(tmp_path))
    bodies = bodies_of(loaded)
    assert set(bodies) == names
    assert [m.name for m in loaded.stage.scene.objects[name].data.materials] == ["wire"]
    assert_same_vertices(bodies[name], expected)
    ball = next(body for body in loaded.bodies if body.name.startswith("Mball"))
    assert np.ptp(ball.vertices[:, 1]) > 2.0  # both balls, grown together


def test_hair_curves_and_particle_hair_become_tubes(tmp_path):
    new_scene()
    hair = bpy.data.hair_curves.new("tuft")
    hair.add_curves([3, 2])
    places = np.array([(0, 0, 0), (0, 0, 1), (0, 0, 2), (1, 0, 0), (1, 1, 0)], np.float32)
    hair.points.foreach_set("position", places.ravel())
    radius = hair.attributes.get("radius") or hair.attributes.new("radius", "FLOAT", "POINT")
    radius.data.foreach_set("value", np.full(5, 0.1, np.float32))
    link("tuft", hair)
    bpy.ops.mesh.primitive_plane_add(location=(5, 0, 0))
    lawn = bpy.context.object
    system = lawn.modifiers.new("grass", "PARTICLE_SYSTEM").particle_system
    system.settings.type, system.settings.count, system.settings.hair_length = "HAIR", 7, 2.0
    name = f"{lawn.name}/{system.name}"
    bodies = bodies_of(open_blend(save(tmp_path)))
    tuft, grass = bodies["tuft"], bodies[name]
    assert np.allclose(tuft.vertices.reshape(-1, 4, 3).mean(1), places, atol=1e-6)
    distance = np.linalg.norm(tuft.vertices.reshape(-1, 4, 3) - places[:, None], axis=2)
    assert np.allclose(distance, 0.1, atol=1e-6)
    assert len(tuft.triangles) == 2 * 4 * 3
    assert len(grass.vertices) % (7 * 4) == 0
    assert np.abs(grass.vertices[:, 0] - 5).max() < 1.1
    assert 1.5 < grass.vertices[:, 2].max() < 2.5


def test_instances_of_collections_and_of_faces_are_realised(tmp_path):
    new_scene()
    group = bpy.data.collections.new("group")
    group.objects.link(bpy.data.objects.new("chair", tetrahedron()))
    for i in range(2):
        empty = link(f"place {i}", None, matrix=Matrix.Translation((4 * i, 0, 1)))
        empty.instance_type, empty.instance_collection = "COLLECTION", group
    emitter = link(
        "emitter",
        mesh_of(
            "quads",
            [(0, 8, 0), (1, 8, 0), (1, 9, 0), (0, 9, 0), (3, 8, 0), (3, 9, 0)],
            [(0, 1, 2, 3), (1, 4, 5, 2)],
        ),
    )
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
    kinds = (
        "GeometryNodeMeshCube",
        "GeometryNodeInstanceOnPoints",
        "NodeGroupOutput",
        "GeometryNodeSetMaterial",
    )
    cube, place, out, paint = (nodes.new(kind) for kind in kinds)
    tree.links.new(nodes.new("NodeGroupInput").outputs[0], place.inputs["Points"])
    paint.inputs["Material"].default_value = emission(
        "gold", lambda tree: tree.nodes.new("ShaderNodeRGB").outputs[0]
    )
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


def test_several_objects_with_one_mesh_get_meshes_of_their_own(tmp_path):
    new_scene()
    mesh = tetrahedron()
    for i in range(3):
        link(f"part {i}", mesh, matrix=Matrix.Translation((i, 0, 0)))
    loaded = open_blend(save(tmp_path))
    assert len({obj.data.name for obj in loaded.stage.objects}) == 3
    build.move(loaded.stage, [np.full((4, 3), 0.1 * i) for i in range(3)])
    for i, (obj, body) in enumerate(zip(loaded.stage.objects, loaded.bodies, strict=True)):
        assert np.allclose(local_vertices(obj.data), body.vertices + 0.1 * i, atol=1e-6)


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
    assert list(bodies["tongue"].groups) == ["tip ü"]
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
        mesh.materials.append(emission(name, lambda tree: tree.nodes.new("ShaderNodeRGB").outputs[0]))
    mesh.polygons.foreach_set("material_index", [0, 1, 1, 0])
    obj = link("part", mesh, matrix=ODD)
    obj.material_slots[1].link = "OBJECT"
    obj.material_slots[1].material = emission(
        "brass", lambda tree: tree.nodes.new("ShaderNodeRGB").outputs[0]
    )
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


def test_volumes_and_grease_pencil_are_named_in_a_warning(tmp_path):
    new_scene()
    link("part", tetrahedron())
    link("smoke", bpy.data.volumes.new("smoke"))
    link("dots", bpy.data.pointclouds.new("dots"))
    warnings = open_blend(save(tmp_path)).warnings
    assert "left out, volume: smoke" in warnings
    assert "left out, pointcloud: dots" in warnings


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


def test_a_scene_of_which_nothing_renders_is_one_line(tmp_path):
    new_scene()
    link("part", tetrahedron()).hide_render = True
    with pytest.raises(
        GenerateError, match=r"user\.blend: nothing in scene 'Scene' is a surface that renders"
    ):
        open_blend(save(tmp_path))


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


def test_a_loaded_scene_renders_and_its_position_pass_lies_on_it(tmp_path):
    new_scene()
    link("part", tetrahedron())
    loaded = open_blend(save(tmp_path))
    picture = render_stage(loaded.stage, tmp_path / "a.exr", view_from((6, 5, 4), (0.3, 0.6, 1)))
    covered = picture[..., 3] > 0.5
    assert 0.05 < covered.mean() < 0.9
    assert picture[covered][:, :3].min() > 0.01  # the sky that was put there lights it


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
    runs = [
        subprocess.run(
            [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    digests = [[line for line in run.splitlines() if line.startswith("digest")] for run in runs]
    assert digests[0]
    assert digests[0] == digests[1]


def test_half_a_million_vertices_in_two_hundred_objects_open_in_seconds(tmp_path):
    new_scene()
    side = 50
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    vertices = np.stack([x, y, 0.1 * np.sin(9 * x)], -1).reshape(-1, 3)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.stack([corner, corner + 1, corner + side + 1, corner + side], 1)
    base = mesh_of("sheet", vertices.tolist(), faces.tolist())
    for i in range(200):
        obj = link(f"sheet {i}", base.copy(), matrix=Matrix.Translation((i % 20, i // 20, 0)))
        if i % 10 == 0:
            obj.vertex_groups.new(name="all").add(range(side * side), 0.5, "REPLACE")
    path = save(tmp_path)
    start = time.perf_counter()
    loaded = open_blend(path)
    seconds = time.perf_counter() - start
    assert sum(len(body.vertices) for body in loaded.bodies) == 500_000
    assert sum(len(body.groups) for body in loaded.bodies) == 20
    print(f"opened in {seconds:.1f} s")
    assert seconds < 30  # about 2 s on two idle cores
