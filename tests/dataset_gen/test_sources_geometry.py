"""Geometry of a user's .blend file equals the evaluated one; mesh files by Blender's exporters and back."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen.errors import GenerateError  # noqa: E402
from dataset_gen.sources import (  # noqa: E402
    open_blend,
    open_mesh,
)
from tests.dataset_gen.sources_blends import (  # noqa: E402
    assert_same_vertices,
    bodies_of,
    emission,
    evaluated,
    link,
    local_vertices,
    new_scene,
    principled,
    render_stage,
    save,
    tetrahedron,
    view_from,
)

ODD = Matrix.LocRotScale((1.0, -2.0, 0.5), Matrix.Rotation(0.7, 3, "X"), (0.5, 2.0, 1.5))
PLACE = Matrix.LocRotScale((10.0, -20.0, 5.0), Matrix.Rotation(0.6, 3, "Z"), (2.0, 2.0, 2.0))
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)], float)


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


def world_corners():
    matrix = np.array(PLACE)
    return CORNERS @ matrix[:3, :3].T + matrix[:3, 3]


def fitted_corners():
    """Where the corners have to come: centred on the bounding box, in a sphere of radius 1.2. And the scale."""
    world = world_corners()
    centred = world - 0.5 * (world.min(0) + world.max(0))
    scale = 1.2 / np.linalg.norm(centred, axis=1).max()
    return centred * scale, scale


def coloured(painted=True, material=False):
    """The scene to export: a tetrahedron with vertex colours or a material, away from the origin."""
    new_scene()
    mesh = tetrahedron()
    if painted:
        paint = mesh.color_attributes.new("Col", "BYTE_COLOR", "CORNER")
        paint.data.foreach_set("color", np.tile(np.float32([0.8, 0.1, 0.05, 1.0]), 12))
        mesh.color_attributes.active_color = paint
    if material:
        mesh.materials.append(principled("red", Base_Color=(0.8, 0.1, 0.05, 1.0)))
    link("tetra", mesh, matrix=PLACE)


def export(path, **options):
    operators = {
        ".glb": bpy.ops.export_scene.gltf, ".gltf": bpy.ops.export_scene.gltf, ".obj": bpy.ops.wm.obj_export,
        ".ply": bpy.ops.wm.ply_export, ".stl": bpy.ops.wm.stl_export, ".fbx": bpy.ops.export_scene.fbx,
    }  # fmt: skip
    if path.suffix == ".gltf":
        options["export_format"] = "GLTF_SEPARATE"
    operators.get(path.suffix, bpy.ops.wm.usd_export)(filepath=str(path), **options)
    return path


def assert_same_set(vertices, wanted, tolerance):
    """Equal sets of points; exporters may split a vertex at every corner."""
    distance = np.linalg.norm(vertices[:, None] - wanted[None], axis=2)
    assert distance.min(1).max() < tolerance
    assert distance.min(0).max() < tolerance


@pytest.mark.parametrize(
    "suffix", [".glb", ".gltf", ".obj", ".ply", ".stl", ".usda", ".usdc", ".usdz", ".fbx"]
)
def test_every_format_gives_the_shape_upright_centred_and_of_the_fixed_size(tmp_path, suffix):
    coloured(material=True)
    loaded = open_mesh(export(tmp_path / f"user{suffix}"))
    (body,) = loaded.bodies
    wanted, scale = fitted_corners()
    assert_same_set(body.vertices, wanted, 2e-5)
    assert np.allclose(loaded.centre, 0.0, atol=1e-5)
    assert loaded.radius == pytest.approx(1.2, abs=1e-5)
    assert len(body.triangles) == 4
    normals = np.cross(
        *(body.vertices[body.triangles[:, i]] - body.vertices[body.triangles[:, 0]] for i in (1, 2))
    )
    outward = body.vertices[body.triangles].mean(1) - wanted.mean(0)
    assert ((normals * outward).sum(1) > 0).all()
    metres = suffix in (".glb", ".gltf", ".usda", ".usdc", ".usdz")
    assert loaded.unit_scale_m == (pytest.approx(1.0 / scale) if metres else None)


def mean_colour(loaded, tmp_path):
    picture = render_stage(loaded.stage, tmp_path / "look.exr", view_from((4, 3, 2)), samples=4)
    covered = picture[..., 3] > 0.99
    assert covered.sum() > 20
    return picture[covered][:, :3].mean(0)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_vertex_colours_are_shown_where_there_is_no_material(tmp_path, suffix):
    coloured()
    options = {".obj": {"export_colors": True}, ".glb": {"export_vertex_color": "ACTIVE"}}.get(suffix, {})
    loaded = open_mesh(export(tmp_path / f"user{suffix}", **options))
    colour = mean_colour(loaded, tmp_path)
    assert colour[0] > 3 * colour[1] > 0
    assert not any("texture" in line for line in loaded.warnings)


def test_a_texture_of_the_file_is_shown_and_a_lost_one_is_named(tmp_path):
    new_scene()
    mesh = tetrahedron()
    mesh.uv_layers.new(name="UVMap")
    picture = bpy.data.images.new("wood", 8, 8)
    picture.filepath_raw, picture.file_format = str(tmp_path / "wood.png"), "PNG"
    picture.pixels.foreach_set(np.tile(np.float32([0.1, 0.8, 0.1, 1.0]), 64))
    picture.save()
    made = principled("wood")
    shader = next(n for n in made.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    texture = made.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = picture
    made.node_tree.links.new(texture.outputs[0], shader.inputs["Base Color"])
    mesh.materials.append(made)
    link("part", mesh)
    path = export(tmp_path / "user.obj", path_mode="RELATIVE")
    loaded = open_mesh(path)
    colour = mean_colour(loaded, tmp_path)
    assert colour[1] > 2 * colour[0]
    assert not loaded.warnings
    (tmp_path / "wood.png").unlink()
    assert any("wood.png is missing: plain grey" in line for line in open_mesh(path).warnings)


def test_an_animated_skinned_file_with_a_camera_stands_still_at_its_first_frame(tmp_path):
    scene = new_scene()
    obj = link("arm", tetrahedron())
    obj.data.materials.append(emission("paint", lambda tree: tree.nodes.new("ShaderNodeTexNoise").outputs[0]))
    obj.keyframe_insert("location", frame=1)
    obj.location.x = 5.0
    obj.keyframe_insert("location", frame=20)
    link("eye", bpy.data.cameras.new("eye"), matrix=view_from((8, 0, 1.5), (0.5, 1, 1.5)))
    link("lamp", bpy.data.lights.new("lamp", "POINT"))
    scene.frame_set(1)
    loaded = open_mesh(export(tmp_path / "user.glb", export_cameras=True, export_lights=True))
    moved = loaded.stage.objects[0]
    before = np.array([tuple(vertex.co) for vertex in moved.data.vertices])
    loaded.stage.scene.frame_set(20)
    assert np.array_equal(before, [tuple(vertex.co) for vertex in moved.data.vertices])
    assert moved.animation_data is None
    (camera,) = loaded.cameras
    scale = 1.2 / np.sqrt(0.25 + 1 + 2.25)
    assert np.allclose(camera.position, (7.5 * scale, -1 * scale, 0.0), atol=1e-5)
    assert np.allclose(camera.camera_to_world, view_from(camera.position), atol=1e-5)
    assert [o.name for o in loaded.stage.scene.objects if o.type == "LIGHT"] == ["soft box"]


def test_what_is_wrong_with_a_file_is_one_line(tmp_path):
    def refused(name, content, complaint):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(GenerateError, match=complaint) as caught:
            open_mesh(path)
        assert "\n" not in str(caught.value)
        assert name in str(caught.value)

    refused("absent.obj", None, "does not exist")
    refused("model.max", b"x", r"extension '\.max' is not one of \.fbx, \.glb, \.gltf, \.obj, \.ply")
    refused("empty.obj", b"", "is empty")
    refused("nothing.obj", b"# no vertices\n", "holds no surface")
    refused("points.obj", b"v 0 0 0\nv 1 0 0\n", "holds no surface")
    refused("one.obj", b"v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n", "one point|holds no surface")
    for suffix in ("glb", "gltf", "ply", "stl", "usda", "usdc", "usdz", "fbx"):
        refused(
            f"garbage.{suffix}", b"this is no such file\n" * 9, r"cannot be imported: \S|holds no surface"
        )
    header = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    header += b"property float x\nproperty float y\nproperty float z\n"
    header += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    places = np.array([(0, 0, 0), (np.nan, 0, 0), (0, 1, 0)], "<f4").tobytes()
    refused("nan.ply", header + places + b"\x03" + np.arange(3, dtype="<i4").tobytes(), "not finite")
    text = header.replace(b"binary_little_endian", b"ascii") + b"0 0 0\n1 -inf 0\n0 1 0\n3 0 1 2\n"
    refused("nan_text.ply", text, "1 of its vertices are not finite")
    refused("nan.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "not finite")
    triangle = np.array([(0, 0, 1), (0, 0, 0), (np.inf, 0, 0), (0, 1, 0)], "<f4").tobytes()
    refused("nan.stl", bytes(80) + np.uint32(1).tobytes() + triangle + bytes(2), "not finite")
    data = {"asset": {"version": "9.0"}, "scenes": [], "nodes": []}
    refused("future.gltf", json.dumps(data).encode(), r"cannot be imported: \S|holds no surface")
