"""The animated .blend: opened afresh, without scripts, it moves as the analytic motion says."""

import json
from functools import partial

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from dataset_gen import animate, build  # noqa: E402
from dataset_gen import meshes as m  # noqa: E402
from dataset_gen.cameras import CameraSetup, cameras_at  # noqa: E402
from dataset_gen.scene import Gradient, Part, Scene, Surface  # noqa: E402
from dataset_gen.vibration import Body, MotionDescription, solve  # noqa: E402

FPS, T = 29.97, 24
MODES = {
    "modes": [
        {
            "name": "sway", "kind": "bending", "frequency": 4.3, "amplitude": 0.01, "phase": 25, "decay": 0.5,
            "base": [0, 0, -0.5], "tip": [0, 0, 0.5], "direction": [1, 0.5, 0], "parts": "rod",
        },
        {
            "name": "ripple", "kind": "wave", "frequency": 6, "amplitude": 0.004, "direction": [1, 0, 0],
            "wavelength": 0.7, "polarisation": "rayleigh", "level": 0.5,
        },
        {
            "name": "hum", "kind": "translate", "frequency": 11, "amplitude": 0.002, "direction": [0, 0, 1],
            "phases": {"plate": 70}, "parts": ["rod", "plate"], "magnified": False,
        },
        {"name": "sag", "kind": "drift", "rate": 0.02, "direction": [0, 1, -1], "magnified": False},
    ]
}  # fmt: skip


def scene():
    checks = np.indices((8, 8)).sum(0)[..., None] % 2 * np.array([0.6, 0.2, 0.1])
    paint = Surface("paint", checks + 0.2, relief=np.eye(8), roughness=np.full((4, 4), 0.4))
    rod = m.revolve([(0.0, -0.5), *((0.05, z) for z in np.linspace(-0.5, 0.5, 9)), (0.0, 0.5)], 12)
    plate = m.revolve([(0.0, 0.55), (0.3, 0.55), (0.3, 0.6), (0.0, 0.6)], 16)
    still = m.revolve([(0.0, -0.7), (0.4, -0.7), (0.4, -0.6), (0.0, -0.6)], 16)
    parts = [("rod", rod, 1.0), ("plate", plate, 1.0), ("foot", still, 0.0)]
    made = tuple(Part(name, mesh, paint, np.full(len(mesh.vertices), f)) for name, mesh, f in parts)
    return Scene("test", made, (), Gradient(((0.5, 0.5, 0.5), (0.6, 0.6, 0.6))))


def solved(description=None, fps=FPS):
    bodies = [Body(p.name, p.mesh.vertices, p.mesh.triangles, p.follow) for p in scene().parts]
    return solve(MotionDescription.from_json(description or MODES), bodies, fps, None, 0)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The file, its motion and the camera setup; the session has it open, loaded without scripts."""
    path = tmp_path_factory.mktemp("animate") / "sub" / "test.blend"
    motion, setup = solved(), CameraSetup("handheld", n_timesteps=T, fps=FPS, test_views=2)
    missing = animate.save_animation(build.build(scene()), motion, T, path, partial(cameras_at, setup), 64)
    assert missing == []
    assert [p.name for p in path.parent.iterdir()] == ["test.blend"]  # nothing half-written is left
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(path), use_scripts=False)
    return path, motion, setup


def evaluated(name):
    obj = bpy.data.objects[name]
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    out = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", out)
    return out.reshape(-1, 3).astype(np.float64)


def show(frame, alpha):
    control = bpy.data.objects["tg4mm"]
    control["alpha"] = alpha
    control.update_tag()
    bpy.context.scene.frame_set(frame)


@pytest.mark.parametrize("alpha", [0.0, 1.0, 50.0, -1.0])
def test_a_reopened_file_moves_as_the_motion_says(saved, alpha):
    _, motion, _ = saved
    for frame in (0, 1, 7, T - 1):
        show(frame, alpha)
        for i, part in enumerate(scene().parts):
            expected = motion.displacement(i, motion.state(frame, alpha))
            np.testing.assert_allclose(evaluated(part.name) - part.mesh.vertices, expected, rtol=0, atol=1e-6)


def test_it_plays_without_scripts(saved):
    assert not bpy.app.autoexec_fail
    drivers = [f.driver for key in bpy.data.shape_keys for f in key.animation_data.drivers]
    # Sway: the rod; ripple: 2 a part; hum: 1 of the rod, 2 of the plate; sag: 1 a part.
    assert len(drivers) == 10
    assert all(d.is_valid and d.is_simple_expression for d in drivers)
    assert all(len(d.expression) < 256 for d in drivers)


def test_its_cameras_stand_where_the_dataset_s_do(saved):
    _, _, setup = saved
    for frame in (0, 5, T - 1):
        show(frame, 0.0)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        for split, cameras in cameras_at(setup, frame).items():
            for camera in cameras:
                found = bpy.data.objects[f"{split} {camera.name}"].evaluated_get(depsgraph)
                np.testing.assert_allclose(np.array(found.matrix_world), camera.camera_to_world, atol=2e-6)
                assert found.data.angle == pytest.approx(camera.angle_x, rel=1e-5)
    assert bpy.context.scene.camera.name == "train r_000"
    assert "camera" not in bpy.data.objects


def test_a_shape_key_s_value_stays_within_its_limits_at_the_largest_alpha(saved):
    show(3, 1000.0)
    assert len(bpy.data.shape_keys) > 0
    for keys in bpy.data.shape_keys:
        for block in keys.evaluated_get(bpy.context.evaluated_depsgraph_get()).key_blocks[1:]:
            assert abs(block.value) < 9.0


def test_a_users_scene_is_saved_with_cameras_around_it(tmp_path):
    """100 units wide and 300 off the origin: the file's cameras and its pixels are those of the data."""
    from dataset_gen.options import parser, request_from
    from dataset_gen.run import save_animation as save

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=100, location=(300, 0, 0))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "own.blend"))
    mode = {"name": "up", "kind": "translate", "frequency": 5, "amplitude_px": 0.5, "direction": [0, 0, 1]}
    (tmp_path / "m.json").write_text(json.dumps({"modes": [mode]}))
    options = ["--blend", str(tmp_path / "own.blend"), "--motion", str(tmp_path / "m.json"), "--out", "x"]
    save(request_from(parser().parse_args(options)).sets[0], tmp_path / "anim.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "anim.blend"))
    places = [np.array(o.matrix_world.translation) for o in bpy.data.objects if o.type == "CAMERA"]
    away = [np.linalg.norm(place - [300, 0, 0]) for place in places]
    assert len(away) >= 35
    assert 100 < min(away) <= max(away) < 600
    assert min(np.linalg.norm(place) for place in places) > 20
