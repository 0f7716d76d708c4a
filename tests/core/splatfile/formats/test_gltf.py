"""A .glb holds the splat and its motion: read back by Blender's importer, by trimesh's and Khronos's validator."""

from dataclasses import replace

import numpy as np
import pytest

from tests.core.splatfile.formats.conftest import turned
from tests.helpers.gltf import parsed
from tg4mm.core.splatfile.axes import y_up
from tg4mm.show.export.gltf import EXTENSION, write_glb

ALPHAS = np.array([4.0, -0.5])


def test_attributes_are_those_of_the_extension(splat, tmp_path):
    write_glb(tmp_path / "a.glb", splat)
    document, array = parsed(tmp_path / "a.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    read = {name: array(number) for name, number in primitive["attributes"].items()}
    want = y_up(splat)
    assert document["extensionsUsed"] == [EXTENSION]
    assert primitive["mode"] == 0
    assert primitive["extensions"][EXTENSION] == {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    np.testing.assert_array_equal(read["POSITION"], want.means)
    np.testing.assert_allclose(read[f"{EXTENSION}:ROTATION"], turned(want)[:, [1, 2, 3, 0]], atol=1e-6)
    np.testing.assert_array_equal(read[f"{EXTENSION}:SCALE"], want.scales)
    np.testing.assert_array_equal(read[f"{EXTENSION}:OPACITY"][:, 0], want.opacities)
    names = [(0, 0), *((1, i) for i in range(3)), *((2, i) for i in range(5)), *((3, i) for i in range(7))]
    for k, (degree, i) in enumerate(names):
        np.testing.assert_array_equal(read[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{i}"], want.sh[:, k])
    assert len(read) == 5 + 16
    assert document["nodes"][0]["scale"] == [0.5, 0.5, 0.5]


@pytest.mark.parametrize("moving", [True, False])
def test_the_validator_of_khronos_objects_to_nothing_else(splat, tmp_path, read_with_node, moving):
    """Its release does not know the extension, and so not the names of its attributes."""
    if not moving:
        none = np.zeros((0, len(splat), 3), np.complex64)
        splat = replace(splat, freqs_hz=np.zeros(0), displacement=none, rotation=none)
    write_glb(tmp_path / "a.glb", splat)
    messages = read_with_node("gltf.cjs", tmp_path / "a.glb")
    others = [m for m in messages if f"attributes/{EXTENSION}:" not in m["pointer"]]
    assert [m["code"] for m in others] == ["UNSUPPORTED_EXTENSION"]
    assert {m["code"] for m in messages if m not in others} == {"MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
    damaged = tmp_path / "b.glb"
    data = (tmp_path / "a.glb").read_bytes()
    damaged.write_bytes(data.replace(b'"type":"VEC4"', b'"type":"VEC2"', 1))
    assert len(read_with_node("gltf.cjs", damaged)) > len(messages)


def test_blender_plays_the_motion_of_the_formula(splat, tmp_path):
    """Its importer turns Y up back to Z up, clamps weights to what sliders allow and mutes what it imports."""
    write_glb(tmp_path / "a.glb", splat, ALPHAS)
    bpy = pytest.importorskip("bpy", reason="Blender's importer reads the file back")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "a.glb"))
    (obj,) = (obj for obj in bpy.data.objects if obj.type == "MESH")
    keys = obj.data.shape_keys
    for block in keys.key_blocks:
        block.slider_min = -1
    (action,) = bpy.data.actions
    keys.animation_data.action, keys.animation_data.action_slot = action, action.slots[0]
    scene, seen = bpy.context.scene, []
    for t in (0, 1, 3.25, 9):
        frame = t / splat.fps * scene.render.fps
        scene.frame_set(int(frame), subframe=frame - int(frame))
        mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        co = np.empty(3 * len(splat), np.float32)
        mesh.vertices.foreach_get("co", co)
        matrix = np.array(obj.matrix_world)
        seen.append(co.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        turns = (1 + ALPHAS) * np.exp(2j * np.pi * splat.freqs_hz * t / splat.fps)
        want = splat.means + np.einsum("m,mnc->nc", turns, splat.displacement).real
        np.testing.assert_allclose(seen[-1], 0.5 * want, atol=1e-4)  # half a metre a unit
    assert np.abs(seen[0] - seen[1]).max() > 0.1
