"""How a user's .blend file looks once it is opened: textures go along with the surface, in every way of laying them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen.sources import open_blend  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    emission,
    link,
    new_scene,
    render_scene,
    render_stage,
    save,
    tetrahedron,
    view_from,
)

TURNED = Matrix.LocRotScale((0.2, -0.3, 0.1), Matrix.Rotation(0.7, 3, "X"), (0.8, 1.2, 0.6))
POSE = view_from((3.2, 2.8, 2.5), (0.4, 0.2, 0.6))


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
