"""What a user's .blend file shows, as plain meshes in world space: the geometry equals the evaluated one."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen.sources import open_blend  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    assert_same_vertices,
    bodies_of,
    emission,
    evaluated,
    link,
    local_vertices,
    new_scene,
    save,
    tetrahedron,
)

ODD = Matrix.LocRotScale((1.0, -2.0, 0.5), Matrix.Rotation(0.7, 3, "X"), (0.5, 2.0, 1.5))


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
