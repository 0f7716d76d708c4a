"""Crop, clean and hand on: what is left is what it was, in Blender and in the files that are written."""

from dataclasses import replace

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import positions_at, read_splat, rotations_at, write_splat
from tg4mm.core.splatfile.formula import transformed

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import drawn_whole, import_files, import_splat, matrices, places, setter  # noqa: E402


def kept(splat, keep):
    """Those of the Gaussians."""
    first = {name: getattr(splat, name)[keep] for name in ("means", "quats", "scales", "opacities", "sh")}
    deviation = None if splat.deviation is None else splat.deviation[:, keep]
    second = {name: getattr(splat, name)[:, keep] for name in ("displacement", "rotation")}
    return replace(splat, **first, **second, deviation=deviation)


def covariances(splat, t=0.0, alpha=-1.0):
    axes = matrices(rotations_at(splat, t, alpha)) * splat.scales[:, None, :].astype(float)
    return axes @ axes.transpose(0, 2, 1)


def assert_alike(found, wanted, metres=True):
    for name in ("means", "sh", "displacement", "rotation", "opacities"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=2e-5, err_msg=name)
    np.testing.assert_allclose(covariances(found), covariances(wanted), atol=1e-6)
    np.testing.assert_array_equal(found.freqs_hz, wanted.freqs_hz)
    assert (found.fps, found.n_timesteps) == (wanted.fps, wanted.n_timesteps)
    if metres:
        assert found.unit_scale_m == pytest.approx(wanted.unit_scale_m)


def exported(path, **options):
    assert bpy.ops.export_scene.tg4mm_splat(filepath=str(path), **options) == {"FINISHED"}
    return read_splat(path)


def box(low, high):
    """A cube mesh with these corners, selected beside the active object."""
    active = bpy.context.object
    middle, half = (np.array(low) + high) / 2, (np.array(high) - low) / 2
    bpy.ops.mesh.primitive_cube_add(size=2, location=middle.tolist(), scale=half.tolist())
    made = bpy.context.object
    bpy.context.view_layer.objects.active = active
    return made


@pytest.fixture(params=[0, 1, 3])
def tagged(request, tmp_path):
    """A file that says everything a splat file can; SH degree 0, 1 and 3."""
    splat = some_splat(degree=request.param)
    write_splat(
        tmp_path / "tagged.ply",
        replace(
            splat,
            unit_scale_m=0.1,
            time_origin_s=2.5,
            low_pass_px2=0.3,
            deviation=np.abs(splat.displacement[..., 0]),
            sh=2 * splat.sh,  # colours past what a screen shows
        ),
    )
    return tmp_path / "tagged.ply"


def test_what_is_exported_is_what_was_imported(extension, tagged, tmp_path):
    import_splat(tagged)
    found, wanted = exported(tmp_path / "out.ply"), read_splat(tagged)
    assert_alike(found, wanted)
    np.testing.assert_allclose(found.deviation, wanted.deviation, rtol=1e-6)
    assert (found.low_pass_px2, found.time_origin_s) == (0.3, 2.5)


@pytest.mark.parametrize("keep", [True, False])
def test_a_box_crops_and_what_is_left_moves_as_before(extension, splat_path, tmp_path, keep):
    obj, splat = import_splat(splat_path), read_splat(splat_path)
    obj.location, obj.rotation_euler = (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)
    bpy.context.view_layer.update()
    drawn_whole(extension, obj)
    setter(extension, obj)(extension.names.ALPHA, 20.0)
    world = splat.means @ np.array(obj.matrix_world)[:3, :3].T + np.array(obj.matrix_world)[:3, 3]
    box((0.5, 1.0, 2.0), (2.0, 3.5, 4.0))
    inside = ((world > (0.5, 1.0, 2.0)) & (world < (2.0, 3.5, 4.0))).all(axis=1)
    assert 0 < inside.sum() < len(splat)
    rest = kept(splat, inside == keep)
    assert bpy.ops.tg4mm.crop(by="BOX", keep=keep) == {"FINISHED"}
    for alpha, frame in ((20.0, 9.5), (0.0, 3.0)):
        setter(extension, obj)(extension.names.ALPHA, alpha)
        np.testing.assert_allclose(places(obj, frame), positions_at(rest, frame - 1, alpha), atol=2e-3)
    largest = [extension.nodes.points.strength(d, np.ones(3))[0].max() for d in rest.displacement]
    assert list(obj[extension.names.MODE_AMPLITUDES]) == pytest.approx(largest)
    world_turn = np.array(obj.matrix_world)
    assert_alike(
        exported(tmp_path / "out.ply"), transformed(rest, world_turn[:3, :3], world_turn[:3, 3]), metres=False
    )


@pytest.mark.parametrize("keep", [True, False])
def test_the_selection_crops_from_edit_mode(extension, splat_path, tmp_path, keep):
    obj, splat = import_splat(splat_path), read_splat(splat_path)
    chosen = splat.means[:, 0] > 0
    flags = np.zeros(len(obj.data.vertices), bool)
    flags[: len(chosen)] = chosen
    obj.data.vertices.foreach_set("select", flags)
    bpy.ops.object.mode_set(mode="EDIT")
    assert bpy.ops.tg4mm.crop(by="SELECTION", keep=keep) == {"FINISHED"}
    assert bpy.context.mode == "EDIT_MESH"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert_alike(exported(tmp_path / "out.ply"), kept(splat, chosen == keep), metres=False)


def floaters():
    """Gaussians of which some are faint, some large, some far, some very far."""
    splat = replace(some_splat(200), opacities=np.full(200, 0.9, np.float32))
    splat = replace(splat, scales=np.full((200, 3), 0.05, np.float32))
    masks = {name: np.arange(200) // 4 == i for i, name in enumerate(("OPACITY", "SIZE", "DISTANCE", "OUT"))}
    splat.opacities[masks["OPACITY"]] = 0.02
    splat.scales[masks["SIZE"], 1] = 2.0
    splat.means[masks["DISTANCE"]] = (0.0, 60.0, 0.0)
    splat.means[masks["OUT"]] = (0.0, 0.0, 4e4)
    splat.opacities[masks["DISTANCE"] | masks["OUT"]] = 0.2  # as floaters are
    return splat, masks


@pytest.mark.parametrize("by", ["OPACITY", "SIZE", "DISTANCE", "OUT"])
def test_floaters_go_and_nothing_else(extension, tmp_path, by):
    splat, masks = floaters()
    write_splat(tmp_path / "a.ply", splat)
    import_splat(tmp_path / "a.ply")
    if by == "OUT":
        bpy.ops.tg4mm.crop_outliers()
    else:
        bpy.ops.tg4mm.remove_floaters(by=by)
    gone = masks[by] | (masks["OUT"] if by == "DISTANCE" else False)
    assert_alike(exported(tmp_path / "out.ply"), kept(splat, ~gone), metres=False)


@pytest.mark.parametrize(
    ("linear", "metres"),
    [(np.diag([2.0, 2.0, 2.0]), 0.05), (np.diag([-1.0, 1.0, 1.0]), 0.1), (np.diag([1.0, 2.0, 0.5]), None)],
)
def test_export_is_in_world_axes_and_units(extension, tagged, tmp_path, linear, metres):
    obj, splat = import_splat(tagged), read_splat(tagged)
    obj.scale, obj.rotation_euler, obj.location = np.diag(linear).tolist(), (0.3, -0.2, 1.0), (1, 2, 3)
    bpy.context.view_layer.update()
    world = np.array(obj.matrix_world)
    found = exported(tmp_path / "out.ply")
    wanted = transformed(splat, world[:3, :3], world[:3, 3])
    assert_alike(found, wanted, metres=False)
    assert found.unit_scale_m == (None if metres is None else pytest.approx(metres))
    np.testing.assert_allclose(
        positions_at(found, 3.3, 9.0),
        positions_at(splat, 3.3, 9.0) @ world[:3, :3].T + world[:3, 3],
        atol=1e-4,
    )


@pytest.mark.parametrize("joined", [False, True])
def test_export_after_apply_transform_is_of_the_same_scene(extension, tagged, tmp_path, joined):
    other = import_splat(tagged) if joined else None
    obj, splat = import_splat(tagged), read_splat(tagged)
    obj.scale, obj.rotation_euler, obj.location = (-2.0, 2.0, 2.0), (0.3, -0.2, 1.0), (1, 2, 3)
    bpy.context.view_layer.update()
    world = np.array(obj.matrix_world)
    wanted = transformed(splat, world[:3, :3], world[:3, 3])
    obj.select_set(True)
    assert bpy.ops.object.transform_apply() == {"FINISHED"}
    if joined:
        other.select_set(True)
        assert bpy.ops.object.join() == {"FINISHED"}
    found = exported(tmp_path / "out.ply")
    assert_alike(kept(found, np.arange(len(found)) < len(splat)), wanted, metres=not joined)
    if joined:
        assert_alike(kept(found, np.arange(len(found)) >= len(splat)), splat, metres=False)
        assert found.unit_scale_m is None  # the parts have different ones
    box((-9.0, -9.0, 3.0), (9.0, 9.0, 9.0))
    assert bpy.ops.tg4mm.crop(by="BOX", keep=True) == {"FINISHED"}  # the references stay
    cropped = exported(tmp_path / "cropped.ply")
    assert_alike(cropped, kept(found, found.means[:, 2] >= 3.0), metres=not joined)


@pytest.mark.parametrize("axes", ["MINUS_Y", "PLUS_Y"])
def test_axes_of_the_import_are_those_of_the_export(extension, splat_path, tmp_path, axes):
    import_splat(splat_path, axes=axes)
    bpy.context.view_layer.update()
    splat = read_splat(splat_path)
    assert_alike(exported(tmp_path / "same.ply"), splat, metres=False)
    up = np.array([0.0, -1.0, 0.0] if axes == "MINUS_Y" else [0.0, 1.0, 0.0])
    blenders = exported(tmp_path / "z.ply", axes="FILE")
    np.testing.assert_allclose(blenders.means[:, 2], splat.means @ up, atol=1e-5)


def test_this_frame_and_rest_hold_no_motion(extension, splat_path, tmp_path):
    obj, splat, names = import_splat(splat_path), read_splat(splat_path), extension.names
    put = setter(extension, obj)
    for name, value in ((names.ALPHA, 10.0), (names.LOW, 4.0), (names.HIGH, 6.0), (names.SPEED, 1.0)):
        put(name, value)
    bpy.context.scene.frame_set(9)
    shown = exported(tmp_path / "now.ply", content="NOW")
    np.testing.assert_allclose(shown.means, positions_at(splat, 8, 10.0, (4.0, 6.0)), atol=1e-4)
    np.testing.assert_allclose(
        covariances(shown, alpha=0.0),
        (axes := matrices(rotations_at(splat, 8, 10.0, (4.0, 6.0))) * splat.scales[:, None])
        @ axes.transpose(0, 2, 1),
        atol=1e-5,
    )
    rest = exported(tmp_path / "rest.ply", content="REST")
    assert (shown.n_modes, rest.n_modes) == (0, 0)
    np.testing.assert_allclose(rest.means, splat.means, atol=1e-6)


def test_a_sequence_has_a_file_for_each_frame_and_comes_back(extension, splat_path, tmp_path):
    obj, splat = import_splat(splat_path), read_splat(splat_path)
    scene, folder = bpy.context.scene, tmp_path / "many"
    folder.mkdir()
    scene.frame_start, scene.frame_end = 3, 6
    modifier = drawn_whole(extension, obj)
    for frame, alpha in ((3, 0.0), (6, 30.0)):  # a key in magnification is followed
        extension.compat.set_input(modifier, extension.names.ALPHA, alpha)
        obj.keyframe_insert(extension.compat.input_path(modifier, extension.names.ALPHA), frame=frame)
    scene.frame_set(20)
    bpy.ops.export_scene.tg4mm_splat(filepath=str(folder / "bell.ply"), content="SEQUENCE")
    files = sorted(folder.iterdir())
    assert [file.name for file in files] == [f"bell_{i:04d}.ply" for i in (1, 2, 3, 4)]
    np.testing.assert_allclose(read_splat(files[0]).means, positions_at(splat, 2, 0.0), atol=1e-5)
    np.testing.assert_allclose(read_splat(files[3]).means, positions_at(splat, 5, 30.0), atol=1e-3)
    assert scene.frame_current == 20
    sequence = import_files(files, motion=False)
    box((0.0, -9.0, -9.0), (9.0, 9.0, 9.0))
    assert bpy.ops.tg4mm.crop(by="BOX", keep=True) == {"FINISHED"}
    scene.frame_set(4)
    wanted = read_splat(files[3])
    assert_alike(exported(tmp_path / "cropped.ply"), kept(wanted, wanted.means[:, 0] >= 0), metres=False)
    assert sequence == bpy.context.object


def test_a_mesh_of_what_is_drawn(extension, splat_path):
    obj, splat = import_splat(splat_path), read_splat(splat_path)
    drawn_whole(extension, obj)
    bpy.context.scene.frame_set(5)
    assert bpy.ops.tg4mm.make_mesh() == {"FINISHED"}
    mesh = bpy.data.objects[f"{obj.name} mesh"].data
    assert len(mesh.polygons) == 80 * len(splat)
    corners = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", corners)
    middles = corners.reshape(len(splat), -1, 3).mean(axis=1)
    np.testing.assert_allclose(middles, positions_at(splat, 4), atol=1e-4)
    assert not extension.compat.get_input(
        extension.nodes.scene.splat_modifier(obj), extension.names.SOLID_COLOUR
    )


def refused(call, message):
    with pytest.raises(RuntimeError, match=message) as caught:
        call()
    assert len(set(filter(None, str(caught.value).splitlines()))) == 1


def test_bad_input_is_one_line_and_changes_nothing(extension, splat_path, tmp_path):
    obj = import_splat(splat_path)
    before = len(obj.data.vertices)
    refused(lambda: bpy.ops.tg4mm.crop(by="BOX"), "No crop box: add one")
    refused(lambda: bpy.ops.tg4mm.crop(by="SELECTION"), "No point is selected")
    box((50.0, 50.0, 50.0), (60.0, 60.0, 60.0))
    refused(lambda: bpy.ops.tg4mm.crop(by="BOX"), "None of 23 Gaussians would be left")
    assert len(obj.data.vertices) == before
    write = bpy.ops.export_scene.tg4mm_splat
    refused(
        lambda: write(filepath=str(tmp_path / "no" / "a.ply")), r"no/a\.ply: cannot be written: No such file"
    )
    bpy.context.scene.frame_end = 100_000
    refused(
        lambda: write(filepath=str(tmp_path / "a.ply"), content="SEQUENCE"), "100,000 files, more than 10,000"
    )
    bpy.context.scene.frame_end = 2
    (tmp_path / "a_0009.ply").touch()
    refused(
        lambda: write(filepath=str(tmp_path / "a.ply"), content="SEQUENCE"), r"holds a_0009\.ply, of another"
    )
    obj.scale = (1.0, 0.0, 1.0)
    bpy.context.view_layer.update()
    refused(lambda: write(filepath=str(tmp_path / "flat.ply")), "scaled by 0 along one direction")
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix == ".ply") == [
        "a_0009.ply",
        "bell.ply",
    ]
