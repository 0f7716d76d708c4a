"""What a new user meets: the startup scene's cube, axes, numbers that are no numbers, recordings without end."""

import json
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import positions_at, read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from bpy_extras.object_utils import world_to_camera_view  # noqa: E402
from mathutils import Vector  # noqa: E402

from tests.addon.playing import drawn_whole, import_splat, places, setter  # noqa: E402

UPS = {"Z": (0.0, 0.0, 1.0), "MINUS_Y": (0.0, -1.0, 0.0), "PLUS_Y": (0.0, 1.0, 0.0)}


@pytest.fixture
def cube(extension):
    """The cube of Blender's startup scene."""
    bpy.ops.mesh.primitive_cube_add(size=2)
    bpy.context.object.name = "Cube"
    return bpy.context.object


def shown(reports, cube):
    return not (cube.hide_get() and cube.hide_render and reports == ["Hid the start-up Cube, in the way"])


def test_the_untouched_startup_cube_is_hidden_and_said(extension, splat_path, cube):
    obj = import_splat(splat_path)
    assert (cube.hide_get(), cube.hide_render) == (True, True)
    cube.hide_set(False)
    assert not shown(extension.panels.framing.show(bpy.context, [obj]), cube)


@pytest.mark.parametrize("touched", ["moved", "edited", "bevelled", "apart"])
def test_a_cube_that_is_someones_own_stays(extension, splat_path, cube, touched):
    if touched == "moved":
        cube.location.x = 0.5
    elif touched == "edited":
        cube.data.vertices[0].co.x = -1.5
    elif touched == "bevelled":
        cube.modifiers.new("bevel", "BEVEL")
    obj = import_splat(splat_path, show=False)
    obj.location.x = 100.0 if touched == "apart" else 0.0
    assert shown(extension.panels.framing.show(bpy.context, [obj]), cube)


def colmap_camera(up):
    """[3, 3] camera-to-world of a level camera, y down, in a world with this up."""
    ahead = np.array([1.0, 0.0, 0.0])
    return np.stack([np.cross(ahead, up), -np.array(up), ahead], axis=1)


def startup_camera():
    """The camera of Blender's startup scene."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (7.358891, -6.925791, 4.958309), (1.109319, 0.0, 0.814928)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    return camera


@pytest.mark.parametrize("moved", [False, True])
def test_the_untouched_startup_camera_frames_the_splats(extension, splat_path, moved):
    camera = startup_camera()
    if moved:
        camera.location.x += 1
    before = np.array(camera.location)
    obj = import_splat(splat_path)
    bpy.context.view_layer.update()
    low, high = extension.panels.framing.box([obj])
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
    seen = np.array([world_to_camera_view(bpy.context.scene, camera, Vector(c)) for c in corners])
    if moved:
        np.testing.assert_array_equal(np.array(camera.location), before)
    else:
        assert ((seen[:, :2] > 0) & (seen[:, :2] < 1)).all()
        assert np.ptp(seen[:, :2], axis=0).max() > 0.4


@pytest.mark.parametrize(("phase", "frame"), [(-1j, 5), (1, 1), (1j, 5)])
def test_an_import_shows_a_frame_in_which_something_moves(extension, tmp_path, phase, frame):
    """A sine of 3 Hz at 24 timesteps a second is at rest in frame 1, and at half speed largest four frames later."""
    splat = some_splat(freqs_hz=(3.0,))
    real = np.abs(splat.displacement) * np.complex64(phase)
    write_splat(tmp_path / "a.ply", replace(splat, displacement=real, rotation=0 * real))
    import_splat(tmp_path / "a.ply")
    assert bpy.context.scene.frame_current == frame
    import_splat(tmp_path / "a.ply", timeline=False)
    assert bpy.context.scene.frame_current == frame


@pytest.mark.parametrize("up", UPS)
@pytest.mark.parametrize("kind", ["cameras.json", "transforms.json"])
def test_up_is_estimated_from_the_cameras(extension, splat_path, up, kind):
    turn = colmap_camera(UPS[up])
    if kind == "cameras.json":
        cameras: Any = [{"rotation": turn.tolist(), "position": [0, 0, 0]}] * 3
    else:
        pose = np.eye(4)
        pose[:3, :3] = turn * [1, -1, -1]
        cameras = {"frames": [{"transform_matrix": pose.tolist()}] * 3}
    (splat_path.parent / kind).write_text(json.dumps(cameras))
    obj = import_splat(splat_path)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(obj.matrix_world)[:3, :3] @ UPS[up], [0, 0, 1], atol=1e-6)


def test_up_can_be_chosen_after_the_import(extension, splat_path):
    obj = import_splat(splat_path)
    obj.location.x = 3.0
    for up in ("MINUS_Y", "PLUS_Y", "FILE", "PLUS_Y"):
        bpy.context.view_layer.update()
        assert bpy.ops.tg4mm.up(axes=up) == {"FINISHED"}
        bpy.context.view_layer.update()
        way = UPS["Z" if up == "FILE" else up]
        np.testing.assert_allclose(np.array(obj.matrix_world)[:3, :3] @ way, [0, 0, 1], atol=1e-6)
        assert obj.location.x == pytest.approx(3.0)


def test_metres_of_the_file_and_of_blender_are_compared(extension, splat_path, tmp_path):
    write_splat(tmp_path / "small.ply", replace(read_splat(splat_path), unit_scale_m=0.1))
    scene, differ = bpy.context.scene, extension.panels.analysis.units_differ
    assert differ(import_splat(splat_path), scene) == ""  # the file does not say
    obj = import_splat(tmp_path / "small.ply")
    assert differ(obj, scene) == "1 unit is 0.1 m in the file, 1 m here"
    assert bpy.ops.tg4mm.file_units() == {"FINISHED"}
    assert scene.unit_settings.scale_length == pytest.approx(0.1)
    assert differ(obj, scene) == ""
    obj.scale = (2, 2, 2)
    bpy.context.view_layer.update()
    assert "0.05 m in the file" in differ(obj, scene)
    obj.select_set(True)
    bpy.ops.object.transform_apply()
    assert "0.05 m in the file" in differ(obj, scene)
    scene.unit_settings.system = "NONE"
    assert differ(obj, scene) == ""


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_finite_number_plays_as_0_and_is_marked(extension, splat_path, value):
    obj, splat, names = import_splat(splat_path), read_splat(splat_path), extension.names
    modifier, put = drawn_whole(extension, obj), setter(extension, obj)
    put(names.ALPHA, value)
    np.testing.assert_allclose(places(obj, 9.5), positions_at(splat, 8.5), atol=1e-4)
    held = extension.compat.get_input(modifier, names.ALPHA)  # 5.3 makes of infinity its largest number
    assert extension.nodes.clock.not_finite(modifier) == [f"Magnification is {held:g}: plays as 0"]
    put(names.ALPHA, 0.0)
    put(names.SPEED, value)
    np.testing.assert_allclose(places(obj, 9.5), positions_at(splat, 0), atol=1e-4)
    assert extension.nodes.clock.lines(bpy.context.scene, obj, modifier)[0] == "0.000 s of 2.000 s, stopped"
    put(names.SPEED, 1.0)
    assert extension.nodes.clock.not_finite(modifier) == []


@pytest.mark.parametrize("n_timesteps", [2**20, 2**31, 10**15])
def test_fifty_modes_of_a_recording_without_end(extension, tmp_path, n_timesteps):
    splat = replace(some_splat(9, tuple(np.linspace(0.2, 11.8, 50))), n_timesteps=n_timesteps)
    write_splat(tmp_path / "long.ply", splat)
    start = time.process_time()
    obj = import_splat(tmp_path / "long.ply")
    assert bpy.context.scene.frame_end == 1_048_574
    setter(extension, obj)(extension.names.ALPHA, -1.0)  # at rest
    bpy.context.scene.cursor.location = splat.means[splat.opacities.argmax()]
    assert bpy.ops.tg4mm.probe(source="CURSOR") == {"FINISHED"}
    found = extension.probe.picking.stored(obj)
    assert found.n_timesteps == n_timesteps
    function, *arguments = extension.probe.picking.curve_picture(
        found, extension.preferences.unit_for(bpy.context, obj), 0.5
    )
    function(*arguments)
    with pytest.raises(RuntimeError, match="write the phasor table"):
        bpy.ops.tg4mm.export_probe(filepath=str(tmp_path / "long.csv"), per_timestep=8)
    assert time.process_time() - start < 10


def one_line(call, message):
    with pytest.raises(RuntimeError, match=message) as caught:
        call()
    lines = set(filter(None, str(caught.value).splitlines()))
    assert len(lines) == 1
    assert "Errno" not in lines.pop()


def test_folders_and_disks_that_cannot_be_used_are_one_line(extension, splat_path, cube):
    one_line(
        lambda: bpy.ops.import_scene.tg4mm_splat(filepath=str(splat_path.parent)),
        "holds no numbered splat files",
    )
    bpy.context.scene.tg4mm_generate.out = str(splat_path)
    one_line(bpy.ops.tg4mm.generate, "cannot be used: (Not a directory|File exists)")
    import_splat(splat_path)
    splat = read_splat(splat_path)
    bpy.context.scene.cursor.location = splat.means[splat.opacities.argmax()]
    bpy.ops.tg4mm.probe(source="CURSOR")
    gone = splat_path.parent / "gone" / "a.csv"
    one_line(
        lambda: bpy.ops.tg4mm.export_probe(filepath=str(gone)), r"a\.csv: cannot be written: No such file"
    )
    one_line(lambda: bpy.ops.tg4mm.export_probe(filepath="/dev/null"), "/dev/null: cannot be written")
