"""The extension in Blender, headless: what is played equals the splat file's own formula."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import SplatFile, positions_at, read_splat, rotations_at, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import (  # noqa: E402
    add_camera,
    blocks,
    drawn_whole,
    import_splat,
    matrices,
    places,
    render_cycles,
    setter,
    transforms,
)


@pytest.mark.parametrize("alpha", [-1.0, 0.0, 20.0])
def test_instances_are_where_the_formula_puts_them(extension, splat_path, alpha):
    obj, splat = import_splat(splat_path), read_splat(splat_path)
    extension.compat.set_input(drawn_whole(extension, obj), extension.names.ALPHA, alpha)
    for frame in (1, 2, 30.25, 250.5):
        t, played, size = frame - 1, transforms(obj, frame), 1 + abs(alpha)
        np.testing.assert_allclose(played[:, :3, 3], positions_at(splat, t, alpha), atol=1e-4 * size)
        turned = matrices(rotations_at(splat, t, alpha)) * splat.scales[:, None, :]
        np.testing.assert_allclose(played[:, :3, :3], turned, atol=2e-4 * size)


@pytest.mark.parametrize("band", [(4.0, 6.0), (5.0, 7.5), (0.0, 3.0), (8.0, 9.0)])
def test_only_modes_inside_the_band_are_magnified(extension, splat_path, band):
    obj = import_splat(splat_path)
    modifier = drawn_whole(extension, obj)
    names = (extension.names.ALPHA, extension.names.LOW, extension.names.HIGH)
    for name, value in zip(names, (10.0, *band), strict=True):
        extension.compat.set_input(modifier, name, value)
    expected = positions_at(read_splat(splat_path), 8.5, 10.0, band)
    np.testing.assert_allclose(transforms(obj, 9.5)[:, :3, 3], expected, atol=1e-3)


def test_first_frame_and_speed_set_the_time(extension, splat_path):
    obj = import_splat(splat_path)
    modifier = drawn_whole(extension, obj)
    extension.compat.set_input(modifier, extension.names.FIRST, 11.0)
    extension.compat.set_input(modifier, extension.names.SPEED, 0.25)
    expected = positions_at(read_splat(splat_path), (40 - 11) * 0.25)
    np.testing.assert_allclose(transforms(obj, 40)[:, :3, 3], expected, atol=1e-4)


@pytest.mark.parametrize(("fps", "base"), [(60, 1.0), (24, 1.001), (5, 1.0)])
def test_motion_takes_as_long_as_it_took_at_any_frame_rate(extension, splat_path, fps, base):
    obj = import_splat(splat_path)
    drawn_whole(extension, obj)
    setter(extension, obj)(extension.names.FIRST, 3.0)
    scene, splat = bpy.context.scene, read_splat(splat_path)
    scene.render.fps, scene.render.fps_base = fps, base
    for frame in (3, 10, 31.5, -4):
        seconds = (frame - 3) / (fps / base)
        np.testing.assert_allclose(places(obj, frame), positions_at(splat, seconds * splat.fps), atol=2e-4)
        now = extension.nodes.clock.timestep(scene, obj, extension.nodes.scene.splat_modifier(obj))
        assert now == pytest.approx(seconds * splat.fps, abs=1e-4)


def test_a_second_import_changes_neither_the_clock_nor_the_first(extension, splat_path, tmp_path):
    first = import_splat(splat_path)
    drawn_whole(extension, first)
    slower = replace(read_splat(splat_path), fps=10.0)
    write_splat(tmp_path / "slower.ply", slower)
    second = import_splat(tmp_path / "slower.ply")
    drawn_whole(extension, second)
    scene = bpy.context.scene
    assert (scene.render.fps / scene.render.fps_base, scene.frame_end) == (24.0, 3 * 48)
    np.testing.assert_allclose(places(first, 13), positions_at(read_splat(splat_path), 12), atol=1e-4)
    np.testing.assert_allclose(places(second, 13), positions_at(slower, 0.5 * 10.0), atol=1e-4)


def test_modes_in_which_nothing_moves_are_left_out(extension, splat_path, tmp_path):
    splat = read_splat(splat_path)
    size = np.array([1e-9, 1.0, 0.0], np.float32)[:, None, None]
    still = replace(splat, displacement=size * splat.displacement, rotation=size * splat.rotation)
    write_splat(tmp_path / "one.ply", still)
    obj = import_splat(tmp_path / "one.ply")
    drawn_whole(extension, obj)
    assert list(obj[extension.names.FREQUENCIES]) == [5.0]
    assert "mode_1_re" not in obj.data.attributes
    np.testing.assert_allclose(places(obj, 9.5), positions_at(still, 8.5), atol=1e-4)


def test_magnification_can_be_driven(extension, splat_path):
    obj = import_splat(splat_path)
    modifier = drawn_whole(extension, obj)
    empty = bpy.data.objects.new("lever", None)
    bpy.context.collection.objects.link(empty)
    driver = obj.driver_add(extension.compat.input_path(modifier, extension.names.ALPHA)).driver
    driver.type = "SUM"
    variable = driver.variables.new()
    variable.type = "TRANSFORMS"
    variable.targets[0].id, variable.targets[0].transform_type = empty, "LOC_X"
    splat = read_splat(splat_path)
    for alpha in (0.0, 7.0):
        empty.location.x = alpha
        np.testing.assert_allclose(places(obj, 9), positions_at(splat, 8, alpha), atol=1e-3)


def test_hidden_modes_contribute_nothing(extension, splat_path):
    obj = import_splat(splat_path)
    drawn_whole(extension, obj)
    put = setter(extension, obj)
    put(extension.names.ALPHA, 6.0)
    splat = read_splat(splat_path)
    for hidden in ({1}, {0, 2}, {0, 1, 2}):
        for k, name in enumerate(("3 Hz", "5 Hz", "7.5 Hz")):
            put(name, k not in hidden)
        kept = [k for k in range(3) if k not in hidden]
        waves = (
            splat.displacement[kept]
            * np.exp(2j * np.pi * splat.freqs_hz[kept] * 6.5 / splat.fps)[:, None, None]
        )
        expected = splat.means + 7.0 * waves.real.sum(axis=0)
        np.testing.assert_allclose(places(obj, 7.5), expected, atol=1e-3)


def test_picture_shows_the_colours_of_the_file(extension, tmp_path):
    """Two large Gaussians under the view transform Standard: the pixels are 0.5 + C0·sh, display-referred."""
    rgb = np.array([[0.9, 0.25, 0.1], [0.2, 0.6, 0.75]])
    sh = ((rgb - 0.5) / 0.28209479)[:, None].astype(np.float32)
    means = np.array([[-0.5, 0, 0], [0.5, 0, 0]], np.float32)
    quats, scales = np.tile(np.float32([1, 0, 0, 0]), (2, 1)), np.full((2, 3), 0.3, np.float32)
    write_splat(tmp_path / "two.ply", SplatFile.static(means, quats, scales, np.ones(2, np.float32), sh))
    import_splat(tmp_path / "two.ply")
    add_camera((0.0, 0.0, 5.0), (16, 8), ortho_scale=2.0)
    assert bpy.ops.tg4mm.true_colours() == {"FINISHED"}
    render_cycles(tmp_path / "two.png", samples=4)
    picture = np.asarray(Image.open(tmp_path / "two.png").convert("RGB"), dtype=float) / 255
    np.testing.assert_allclose(picture[4, [4, 12]], rgb, atol=0.006)


def test_timeline_is_taken_from_the_file_unless_declined(extension, splat_path):
    scene = bpy.context.scene
    scene.render.fps, scene.frame_end = 60, 100
    import_splat(splat_path, timeline=False)
    assert (scene.render.fps, scene.frame_end) == (60, 100)
    bpy.data.objects.remove(bpy.context.object)
    import_splat(splat_path)
    assert scene.render.fps / scene.render.fps_base == pytest.approx(24.0)
    assert (scene.frame_start, scene.frame_end) == (1, 3 * 48)


def test_the_strongest_mode_has_at_least_twelve_frames_a_period(extension, splat_path):
    obj, names = import_splat(splat_path), extension.names
    rate, speed = 24.0, extension.compat.get_input(extension.nodes.scene.splat_modifier(obj), names.SPEED)
    assert speed == pytest.approx(1 / 3)  # strongest: 5 Hz, 5 frames a period in real time
    assert rate / (speed * extension.nodes.scene.strongest(obj)) >= 12
    second = import_splat(splat_path, timeline=True)
    assert extension.compat.get_input(extension.nodes.scene.splat_modifier(second), names.SPEED) == speed
    slow = extension.nodes.clock.slow_motion
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = 30, 1.0
    assert [slow(bpy.context.scene, f) for f in (0.0, 1.0, 2.5, 2.6, 5.0, 14.0)] == [1, 1, 1, 2, 2, 6]


def test_import_is_undone_and_redone(extension, splat_path):
    bpy.ops.ed.undo_push(message="before")
    before = blocks()
    bpy.ops.import_scene.tg4mm_splat("EXEC_DEFAULT", True, filepath=str(splat_path))
    after = blocks()
    assert bpy.ops.ed.undo() == {"FINISHED"}
    assert blocks() == before
    assert bpy.ops.ed.redo() == {"FINISHED"}
    assert blocks() == after != before
    assert np.isfinite(places(bpy.data.objects["bell"], 5)).all()


def test_many_modes_are_one_group_used_many_times(extension, tmp_path):
    """Blender's time for a change of a tree grows with the tree: 64 modes in one tree took a minute to import."""
    freqs = tuple(0.18 * k for k in range(1, 65))
    splat = some_splat(9, freqs)
    write_splat(tmp_path / "many.ply", splat)
    obj = import_splat(tmp_path / "many.ply")
    extension.compat.set_input(drawn_whole(extension, obj), extension.names.ALPHA, 2.0)
    np.testing.assert_allclose(places(obj, 12), positions_at(splat, 11, 2.0), atol=2e-3)
    trees = [tree for tree in bpy.data.node_groups if tree.bl_idname == "GeometryNodeTree"]
    assert max(len(tree.nodes) for tree in trees) < 64 + 40
    assert sum(tree.name.endswith(" Mode") for tree in trees) == 1
