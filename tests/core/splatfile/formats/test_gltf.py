"""A .glb holds the splat and its motion: read back by Blender's importer, by trimesh's and Khronos's validator."""

from dataclasses import replace

import gsply
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdValidation

from tests.core.splatfile.formats.conftest import angles, turned
from tests.helpers.splat_files import parsed
from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile, positions_at, rotations_at
from tg4mm.core.splatfile.formula import y_up
from tg4mm.core.splatfile.spz import write_spz
from tg4mm.show.export.gltf import EXTENSION, write_glb
from tg4mm.show.export.usd import write_usd

ALPHAS = np.array([4.0, -0.5])

HALF_STEPS = {"alphas": 0.5 / 255, "sh0": 0.5 / (0.15 * 255), "sh": 0.5 / 128, "scales": 0.5 / 16}
ROUNDING = 1.001

ROWS = {  # attribute → field, and how many rows a Gaussian has
    "positions": ("means", 1),
    "scales": ("scales", 1),
    "opacities": ("opacities", 1),
    "radiance:sphericalHarmonicsCoefficients": ("sh", 16),
}


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


def test_a_reader_of_others_gets_what_was_written(splat, tmp_path):
    write_spz(tmp_path / "a.spz", splat)
    read, want = gsply.read_spz(str(tmp_path / "a.spz")), y_up(splat)
    np.testing.assert_allclose(read.means, want.means, atol=2.0**-21)
    assert angles(read.quats, turned(want)).max() < 0.25
    np.testing.assert_allclose(read.scales, np.log(want.scales), atol=HALF_STEPS["scales"] * ROUNDING)
    np.testing.assert_allclose(read.sh0, want.sh[:, 0], atol=HALF_STEPS["sh0"] * ROUNDING)
    np.testing.assert_allclose(read.shN, want.sh[:, 1:], atol=HALF_STEPS["sh"] * ROUNDING)


def test_the_reference_library_gets_what_was_written(splat, tmp_path, read_with_node):
    write_spz(tmp_path / "a.spz", splat)
    read, want = read_with_node("spz.cjs", tmp_path / "a.spz"), y_up(splat)
    n = len(splat)
    assert (read["numPoints"], read["shDegree"]) == (n, 3)
    np.testing.assert_allclose(np.reshape(read["positions"], (n, 3)), want.means, atol=2.0**-21)
    assert angles(np.reshape(read["rotations"], (n, 4))[:, [3, 0, 1, 2]], turned(want)).max() < 0.25
    np.testing.assert_allclose(read["alphas"], want.opacities, atol=HALF_STEPS["alphas"] * ROUNDING)
    scales = np.log(np.reshape(read["scales"], (n, 3)))
    np.testing.assert_allclose(scales, np.log(want.scales), atol=HALF_STEPS["scales"] * ROUNDING)
    sh = np.reshape(read["sh"], (n, 15, 3))
    np.testing.assert_allclose(sh, want.sh[:, 1:], atol=HALF_STEPS["sh"] * ROUNDING)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e4])
def test_a_motion_far_below_the_usual_grid_survives(splat, tmp_path, size):
    """The usual grid of 1/4096 would leave nothing of a motion of a hundred-thousandth of the scene."""
    shift = np.float32(1e-5 * size)
    for name, moved in (("a", 0.0), ("b", shift)):
        means = (size * np.clip(splat.means, -3, 3) + [moved, 0, 0]).astype(np.float32)
        write_spz(tmp_path / f"{name}.spz", replace(splat, means=means))
    step = gsply.read_spz(str(tmp_path / "b.spz")).means - gsply.read_spz(str(tmp_path / "a.spz")).means
    np.testing.assert_allclose(step[:, 0], shift, rtol=0.2 if size >= 1 else 1.0)


def test_what_is_out_of_range_is_the_nearest_there_is(splat, tmp_path):
    tiny, bright = np.full_like(splat.scales, 1e-9), np.full_like(splat.sh[:, :1], 9.0)
    write_spz(tmp_path / "a.spz", replace(splat, scales=tiny, sh=bright))
    read = gsply.read_spz(str(tmp_path / "a.spz"))
    np.testing.assert_array_equal(read.scales, -10)
    np.testing.assert_allclose(read.sh0, 0.5 / 0.15, rtol=1e-6)


def test_positions_that_do_not_fit_are_refused(splat, tmp_path):
    far = replace(splat, means=splat.means * np.float32(1e8))
    said = r"a\.spz: a position is .* scene units off the origin; spz holds up to"
    with pytest.raises(SplatFileError, match=said):
        write_spz(tmp_path / "a.spz", far)
    assert list(tmp_path.iterdir()) == []


def moments(splat, timesteps):
    for t in timesteps:
        means, quats = positions_at(splat, t).astype(np.float32), rotations_at(splat, t).astype(np.float32)
        one = SplatFile.static(means, quats, splat.scales, splat.opacities, splat.sh, splat.unit_scale_m)
        yield t, one


def values(prim, name, t):
    return np.array(prim.GetAttribute(name).Get(t))


@pytest.mark.parametrize("suffix", ["usdc", "usda"])
def test_every_timestep_is_there(splat, tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    frames = list(moments(splat, range(5)))
    write_usd(path, frames, splat.fps)
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetDefaultPrim()
    assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (30, 0, 4)
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.5)
    assert prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 3
    for t, one in frames:
        for name, (field, rows) in ROWS.items():
            want = getattr(one, field).reshape(len(one) * rows, -1)
            np.testing.assert_array_equal(values(prim, name, t).reshape(want.shape), want, err_msg=name)
        quats = [(q.real, *q.imaginary) for q in prim.GetAttribute("orientations").Get(t)]
        assert angles(np.array(quats), turned(one)).max() < 0.1
    assert prim.GetAttribute("scales").GetNumTimeSamples() == 0  # what does not change is there once
    low, high = values(prim, "extent", 0)
    for _, one in frames:
        assert (one.means >= low).all()
        assert (one.means <= high).all()


def test_openusd_validators_find_nothing(splat, tmp_path):
    write_usd(tmp_path / "a.usdc", moments(splat, range(3)), 30.0)
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    context = UsdValidation.ValidationContext(validators)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert [str(error.GetMessage()) for error in context.Validate(stage)] == []
    stage.ClearMetadata("metersPerUnit")
    assert context.Validate(stage)


def test_an_error_on_the_way_leaves_nothing(splat, tmp_path):
    def broken():
        yield from moments(splat, [0])
        raise SplatFileError("no more")

    with pytest.raises(SplatFileError, match=r"a\.usdc: no more"):
        write_usd(tmp_path / "a.usdc", broken(), 30.0)
    assert list(tmp_path.iterdir()) == []
