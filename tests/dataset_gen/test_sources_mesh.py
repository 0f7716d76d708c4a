"""Mesh files through Blender's own exporters and back: shape, size, colours, and what is wrong with a file."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen.errors import GenerateError  # noqa: E402
from dataset_gen.sources import open_mesh  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    emission,
    link,
    new_scene,
    principled,
    render_stage,
    tetrahedron,
    view_from,
)

PLACE = Matrix.LocRotScale((10.0, -20.0, 5.0), Matrix.Rotation(0.6, 3, "Z"), (2.0, 2.0, 2.0))
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)], float)


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
