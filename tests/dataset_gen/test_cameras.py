"""The spiral against the published poses, and what a NeRF-synthetic loader expects."""

from dataclasses import replace

import numpy as np
import pytest

from dataset_gen import cameras as views
from dataset_gen.cameras import (
    CAMERA_ANGLE_X,
    Camera,
    CameraSetup,
    cameras_at,
    clock_offsets,
    look_at,
    scene_cameras,
    scene_time,
    train_cameras,
    transforms,
)
from dataset_gen.errors import GenerateError

# From transforms_train.json and transforms_test.json there: position of the camera, as written.
TRAIN_29 = (1.14926028, 2.58125353, 2.87512302)
TEST_8 = (2.96205878, -2.39862895, 1.31254947)


def test_known_positions_of_the_published_set():
    np.testing.assert_allclose(train_cameras(30)[29].camera_to_world[:3, 3], TRAIN_29, atol=1e-5)
    np.testing.assert_allclose(views.test_cameras(5)[4].camera_to_world[:3, 3], TEST_8, atol=1e-5)


def test_intrinsics_stand_in_every_frame_and_at_the_top_where_all_agree():
    one, two = train_cameras(2)
    other = Camera(1, two.camera_to_world, angle_x=0.8, shift=(0.01, -0.02))
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
    camera = Camera(0, train_cameras(7)[3].camera_to_world, angle_x=0.9, shift=(0.1, -0.05))
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


SHEARED = np.eye(4) + np.array([[0, 0.2, 0, 0], [0] * 4, [0] * 4, [0] * 4])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Camera(2, SHEARED), r"camera 2: its pose is not rigid, off by 0.2"),
        (lambda: Camera(2, np.diag([-1.0, 1, 1, 1])), r"camera 2: its pose is not rigid"),
        (lambda: Camera(2, np.full((4, 4), np.nan)), r"camera 2: its pose is not a finite 4×4 matrix"),
        (lambda: Camera(2, np.eye(4), angle_x=3.1), r"field of view 177.617° is not in"),
        (lambda: Camera(2, np.eye(4), angle_x=np.nan), r"field of view nan° is not in"),
        (lambda: Camera(2, np.eye(4), shift=(np.inf, 0)), r"principal point is off by \(inf, 0\)"),
        (lambda: scene_cameras([np.diag([1.0, 0, 1, 1])], [0.7]), r"camera 0: its pose is flattened"),
        (lambda: look_at(np.ones(3), np.ones(3)), r"cannot look at its own position"),
    ],
)
def test_unusable_cameras_are_refused(make, message):
    with pytest.raises(GenerateError, match=message):
        make()


RIG = CameraSetup("rig", views=6, clock_offset_s=0.4)
CLIPS = CameraSetup("clips", views=7, n_timesteps=75)


def test_clocks_are_off_by_up_to_what_was_asked_and_the_first_is_the_scenes():
    offsets = np.array(clock_offsets(RIG))
    assert offsets[0] == 0.0
    assert len(set(offsets)) == 6
    assert np.abs(offsets).max() <= 0.4
    many = np.array(clock_offsets(replace(RIG, views=200)))
    assert many.min() < -0.35
    assert many.max() > 0.35
    assert clock_offsets(replace(RIG, seed=3)) != clock_offsets(RIG)
    camera = cameras_at(RIG, 9)["train"][4]
    assert scene_time(RIG, camera, 9) == pytest.approx(0.3 + offsets[4])


def test_clips_follow_one_another_with_pauses():
    starts = np.array(clock_offsets(CLIPS))
    assert starts[0] == 0.0
    gaps = np.diff(starts)
    assert gaps.min() >= 75 / 30 + 2.0 - 1e-6
    assert gaps.max() <= 75 / 30 + 10.0 + 1e-6
    assert len(set((starts * 3.4 % 1.0).round(3))) == 7  # each its own phase
