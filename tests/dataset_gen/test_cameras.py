"""Cameras: the published spiral, what a NeRF-synthetic loader expects, every kind of setup, which cuts nothing off."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from PIL import Image

from dataset_gen import cameras as views
from dataset_gen.cameras import (
    CAMERA_ANGLE_X,
    CameraSetup,
    SceneCamera,
    cameras_at,
    clock_offsets,
    look_at,
    scene_cameras,
    scene_time,
    train_cameras,
    transforms,
)
from dataset_gen.cameras.paths import Tremor, half_widths
from dataset_gen.errors import GenerateError
from dataset_gen.prepare import bodies_of, framed
from dataset_gen.scenes import NAMES
from dataset_gen.settings import Settings, motion_file
from dataset_gen.vibration import read_motion, solve
from tests.dataset_gen import builtin
from tg4mm.capture import load_capture

# From transforms_train.json and transforms_test.json there: position of the camera, as written.
TRAIN_29 = (1.14926028, 2.58125353, 2.87512302)
TEST_8 = (2.96205878, -2.39862895, 1.31254947)
SHEARED = np.eye(4) + np.array([[0, 0.2, 0, 0], [0] * 4, [0] * 4, [0] * 4])
OFF = CameraSetup("rig", views=6, clock_offset_s=0.4)
LATER = CameraSetup("clips", views=7, n_timesteps=75)

RIG = CameraSetup("rig", views=9, test_views=3)
SWEEP = CameraSetup("sweep", views=12, test_views=3)
CLIPS = CameraSetup("clips", views=5, test_views=3)
FLAT = CameraSetup("flat")
HELD = CameraSetup("handheld", test_views=4, n_timesteps=120, fps=30.0, seed=5)
SOME_CAMERAS = tuple(camera.numbered(i) for i, camera in enumerate(train_cameras(9)[4:7]))
GIVEN = CameraSetup("given", test_views=0, given=SOME_CAMERAS)
EVERY = (CameraSetup(), RIG, SWEEP, HELD, CLIPS, FLAT, GIVEN)

SETUPS = (
    CameraSetup("rig", views=9),
    CameraSetup("sweep", views=9),
    CameraSetup("handheld", n_timesteps=48, fps=24.0),
    CameraSetup("clips", views=5),
    CameraSetup("flat"),
)
ALPHA = 100  # the largest of the presets
MARGIN = 0.97  # of the half width; cameras stand so that the points that they were placed by are within 0.96
SOME = [name if name == "mic" else pytest.param(name, marks=pytest.mark.slow) for name in NAMES]


def test_known_positions_of_the_published_set():
    np.testing.assert_allclose(train_cameras(30)[29].camera_to_world[:3, 3], TRAIN_29, atol=1e-5)
    np.testing.assert_allclose(views.test_cameras(5)[4].camera_to_world[:3, 3], TEST_8, atol=1e-5)


def test_intrinsics_stand_in_every_frame_and_at_the_top_where_all_agree():
    one, two = train_cameras(2)
    other = SceneCamera(1, two.camera_to_world, angle_x=0.8, shift=(0.01, -0.02))
    data = transforms([one, other], "train", 0.0, 200, 100)
    assert (data["w"], data["h"]) == (200, 100)
    assert not {"fl_x", "fl_y", "cx", "cy"} & set(data)
    assert data["camera_angle_x"] == CAMERA_ANGLE_X
    frame = data["frames"][1]
    assert frame["fl_x"] == frame["fl_y"] == pytest.approx(100 / np.tan(0.4))
    assert (frame["cx"], frame["cy"]) == pytest.approx((102.0, 46.0))
    assert data["frames"][0]["cx"] == 100.0


def test_projection_is_that_of_the_conventions():
    """docs/conventions.md, by K and the world-to-camera matrix with OpenCV axes, which is another way."""
    camera = SceneCamera(0, train_cameras(7)[3].camera_to_world, angle_x=0.9, shift=(0.1, -0.05))
    points = np.random.default_rng(1).uniform(-1, 1, (20, 3))
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(camera.camera_to_world)
    (cx, cy), focal = camera.principal_point(64, 48), camera.focal(64)
    K = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    local = (K @ (view[:3, :3] @ points.T + view[:3, 3:])).T
    pixels, depth = camera.project(points, 64, 48)
    np.testing.assert_allclose(pixels, local[:, :2] / local[:, 2:], atol=1e-9)
    np.testing.assert_allclose(depth, local[:, 2], atol=1e-12)


def test_scaled_poses_of_a_users_scene_become_rigid():
    pose = train_cameras(3)[1].camera_to_world @ np.diag([0.5, 2.0, 3.0, 1.0])
    (camera,) = scene_cameras([pose], [0.7], [(0.1, 0.0)])
    np.testing.assert_allclose(camera.camera_to_world, train_cameras(3)[1].camera_to_world, atol=1e-12)
    assert (camera.index, camera.angle_x, camera.shift) == (0, 0.7, (0.1, 0.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SceneCamera(2, SHEARED), r"camera 2: its pose is not rigid, off by 0.2"),
        (lambda: SceneCamera(2, np.diag([-1.0, 1, 1, 1])), r"camera 2: its pose is not rigid"),
        (lambda: SceneCamera(2, np.full((4, 4), np.nan)), r"camera 2: its pose is not a finite 4×4 matrix"),
        (lambda: SceneCamera(2, np.eye(4), angle_x=3.1), r"field of view 177.617° is not in"),
        (lambda: SceneCamera(2, np.eye(4), angle_x=np.nan), r"field of view nan° is not in"),
        (lambda: SceneCamera(2, np.eye(4), shift=(np.inf, 0)), r"principal-point offset is \(inf, 0\)"),
        (lambda: scene_cameras([np.diag([1.0, 0, 1, 1])], [0.7]), r"camera 0: its pose is flattened"),
        (lambda: look_at(np.ones(3), np.ones(3)), r"cannot look at its own position"),
    ],
)
def test_unusable_cameras_are_refused(make, message):
    with pytest.raises(GenerateError, match=message):
        make()


def test_clocks_are_off_by_up_to_what_was_asked_and_the_first_is_the_scenes():
    offsets = np.array(clock_offsets(OFF))
    assert offsets[0] == 0.0
    assert len(set(offsets)) == 6
    assert np.abs(offsets).max() <= 0.4
    many = np.array(clock_offsets(replace(OFF, views=200)))
    assert many.min() < -0.35
    assert many.max() > 0.35
    assert clock_offsets(replace(OFF, seed=3)) != clock_offsets(OFF)
    camera = cameras_at(OFF, 9)["train"][4]
    assert scene_time(OFF, camera, 9) == pytest.approx(0.3 + offsets[4])


def test_clips_follow_one_another_with_pauses():
    starts = np.array(clock_offsets(LATER))
    assert starts[0] == 0.0
    gaps = np.diff(starts)
    assert gaps.min() >= 75 / 30 + 2.0 - 1e-6
    assert gaps.max() <= 75 / 30 + 10.0 + 1e-6
    assert len(set((starts * 3.4 % 1.0).round(3))) == 7  # each its own phase


@pytest.mark.parametrize("setup", EVERY, ids=lambda s: s.kind)
def test_a_setup_comes_back_from_json_with_the_same_cameras(setup):
    back = CameraSetup.from_json(json.loads(json.dumps(setup.to_json())))
    assert back == setup
    assert cameras_at(back, 3) == cameras_at(setup, 3)


@pytest.mark.parametrize("n", [1, 2, 6, 7, 12, 17, 40])
def test_a_rig_stands_all_around_at_some_elevations_with_different_lenses(n):
    cameras = cameras_at(replace(RIG, views=n), 0)["train"]
    assert len(cameras) == n
    places = np.array([camera.position for camera in cameras])
    distance = np.linalg.norm(places, axis=1)
    assert (np.abs(distance / CameraSetup().distance - 1) < 0.021).all()
    elevations = np.degrees(np.arcsin(places[:, 2] / distance))
    rows = 1 if n <= 6 else 2 if n <= 16 else 3
    assert 1 + (np.diff(np.sort(elevations)) > 6).sum() == rows
    assert len({camera.angle_x for camera in cameras}) == n
    assert all(0.949 < camera.angle_x / CameraSetup().angle_x < 1.051 for camera in cameras)
    if n >= 12:  # no gap between neighbours in azimuth above 90 degrees
        azimuths = np.sort(np.arctan2(places[:, 1], places[:, 0]))
        assert np.diff([*azimuths, azimuths[0] + 2 * np.pi]).max() < np.pi / 2


def test_the_hand_held_camera_moves_a_little_every_frame_and_smoothly():
    poses = np.array([cameras_at(HELD, t)["train"][0].camera_to_world for t in range(HELD.n_timesteps)])
    places = poses[:, :3, 3]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / HELD.distance
    assert steps.min() > 5e-4
    assert steps.max() < 0.03  # 15 degrees a second are 0.009 a frame, and tremor comes on top
    jerk = np.linalg.norm(np.diff(places, 2, axis=0), axis=1) / HELD.distance
    assert jerk.max() < 0.004
    assert len({cameras_at(HELD, t)["train"][0] for t in range(HELD.n_timesteps)}) == HELD.n_timesteps
    assert {cameras_at(HELD, t)["train"][0].name for t in range(9)} == {"r_000"}


@pytest.mark.parametrize("fps", [12.0, 30.0, 240.0])
def test_tremor_is_band_limited_with_the_stated_size_and_a_falling_spectrum(fps):
    tremor = Tremor.of(3, fps)
    highest = min(8.0, 0.4 * fps)
    assert tremor.frequencies_hz.max() <= highest
    seconds = 200.0
    series = np.array([np.concatenate(tremor.at(t / fps)) for t in range(int(seconds * fps))])
    np.testing.assert_allclose(series.std(0), 1.0, atol=0.1)
    power = np.abs(np.fft.rfft(series * np.hanning(len(series))[:, None], axis=0)) ** 2
    f = np.fft.rfftfreq(len(series), 1 / fps)
    assert power[f > highest + 0.1].sum() < 1e-3 * power.sum()
    density = [power[(f > lo) & (f < 2 * lo)].sum(0).mean() / lo for lo in (0.4, 0.8, 1.6)]
    assert 2.0 < density[0] / density[1] < 8.0  # 4 where the density of power falls as 1/f²
    assert 2.0 < density[1] / density[2] < 8.0


def test_cameras_of_a_users_scene_are_taken_as_they_are():
    found = (SceneCamera(4, train_cameras(3)[1].camera_to_world, angle_x=0.4), train_cameras(3)[2])
    placed = CameraSetup("given", test_views=0).placed((0, 0, 0), 1.0, found)
    assert cameras_at(placed, 2)["train"] == (found[0].numbered(0), found[1].numbered(1))
    assert cameras_at(placed, 2)["test"] == ()


@pytest.mark.parametrize("setup", [RIG, SWEEP, HELD, CLIPS, FLAT], ids=lambda s: s.kind)
def test_a_reader_gets_the_poses_and_lenses_back(setup, tmp_path):
    setup = replace(setup, n_timesteps=3)
    expected = []
    for t in range(3):
        cameras = cameras_at(setup, t)["train"]
        expected += cameras
        folder = tmp_path / f"{t:03d}"
        (folder / "train").mkdir(parents=True)
        data = transforms(cameras, "train", t / setup.fps, 24, 16)
        (folder / "transforms_train.json").write_text(json.dumps(data))
        for camera in cameras:
            Image.new("RGBA", (24, 16)).save(folder / "train" / f"{camera.name}.png")
    (tmp_path / "scene.json").write_text(json.dumps({"fps": setup.fps}))
    capture = load_capture(tmp_path)
    assert [path.stem for path in capture.paths] == [camera.name for camera in expected]
    for i, camera in enumerate(expected):
        view = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(camera.camera_to_world)
        np.testing.assert_allclose(capture.viewmats[i], view, atol=1e-9)
        focal, (cx, cy) = camera.focal(24), camera.principal_point(24, 16)
        np.testing.assert_allclose(capture.Ks[i], [[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    count = {"rig": 9, "sweep": 13, "handheld": 3, "clips": 5, "flat": 1}[setup.kind]
    assert len(set(capture.camera_ids.tolist())) == count


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "drone"}, r"'drone' is not one of orbit, rig, sweep, handheld, clips, flat, given"),
        ({"clock_offset_s": -1.0}, r"--clock-offsets -1.0 is not in 0 … 10000 seconds"),
        ({"kind": "sweep", "clock_offset_s": 0.1}, r"--clock-offsets 0.1: with --cameras sweep no two"),
        ({"views": True}, r"--views True"),
        ({"test_views": 1001}, r"--test-views 1001"),
        ({"distance": 0.0}, r"distance 0.0 is not in"),
        ({"centre": (0.0, float("nan"), 0.0)}, r"centre \(0.0, nan, 0.0\) is not three numbers"),
        ({"angle_x": 3.0}, r"field of view 3.0 is not in"),
        ({"given": (train_cameras(2)[1],)}, r"given cameras are numbered \[1\]"),
    ],
)
def test_unusable_setups_are_refused(changes, message):
    with pytest.raises(GenerateError, match=message):
        CameraSetup(**changes)


def settings_of(name, cameras):
    motion = read_motion(motion_file(name))
    return Settings(name, motion=motion, cameras=cameras, alphas=(ALPHA,), size=128, samples=1, truth="none")


@lru_cache(maxsize=1)
def moved(name):
    """Bodies of a scene, and its points at some timesteps, as captured and magnified."""
    bodies = bodies_of(builtin.built(name))
    motion = solve(read_motion(motion_file(name)), bodies, 30.0, None, 0)

    def scene(alpha, timesteps):
        return [
            np.concatenate([b.vertices + motion.displacement(i, state) for i, b in enumerate(bodies)])
            for state in (motion.state(t, alpha) for t in timesteps)
        ]

    return bodies, scene(0.0, (2, 7)), scene(ALPHA, (1, 4, 8))


@pytest.mark.parametrize("setup", SETUPS, ids=lambda setup: setup.kind)
@pytest.mark.parametrize("name", SOME)  # scene by scene: each is built once
def test_all_that_moves_is_in_every_picture(setup, name):
    """Every vertex at several timesteps, projected into every camera of every kind."""
    bodies, captured, magnified = moved(name)
    cameras = framed(settings_of(name, setup), bodies).cameras
    assert 1.0 <= cameras.clearance < 1.2
    assert 1.0 <= cameras.test_clearance < 1.45
    for t in range(0, setup.n_timesteps, 9) if setup.kind == "handheld" else (0,):
        for camera in cameras_at(cameras, t)["train"]:
            assert max(half_widths(camera, points) for points in captured) < MARGIN, camera.name
    if setup.kind != "flat":  # whose test view is that of its one camera
        for camera in cameras_at(cameras, 0)["test"]:
            assert max(half_widths(camera, points) for points in magnified) < MARGIN, camera.name


def test_moving_back_keeps_directions_and_the_orbit_stays():
    cube = 1.6 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    setup = CameraSetup("clips", views=5)
    framed = setup.framing(cube)
    assert framed.clearance > 1.3
    for near, far in zip(cameras_at(setup, 0)["train"], cameras_at(framed, 0)["train"], strict=True):
        np.testing.assert_allclose(far.position, near.position * framed.clearance)
        np.testing.assert_allclose(far.camera_to_world[:3, :3], near.camera_to_world[:3, :3], atol=1e-12)
        assert half_widths(far, cube) <= 0.96
    closer = replace(framed, clearance=framed.clearance / 1.01)
    assert max(half_widths(camera, cube) for camera in cameras_at(closer, 0)["train"]) > 0.96
    orbit = CameraSetup()
    assert orbit.framing(cube) == orbit


def test_test_cameras_stand_back_for_what_they_alone_see():
    cube = 0.5 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    setup = CameraSetup("rig", views=5)
    assert setup.framing(cube) == setup
    framed = setup.framing(cube, 3.0 * cube)
    assert framed.clearance == 1.0
    assert framed.test_clearance > 1.2
    assert cameras_at(framed, 0)["train"] == cameras_at(setup, 0)["train"]
    assert all(half_widths(camera, 3.0 * cube) <= 0.96 for camera in cameras_at(framed, 0)["test"])
    assert CameraSetup.from_json(framed.to_json()) == framed
    assert "test_clearance" not in setup.to_json()
