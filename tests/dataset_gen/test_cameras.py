"""The spiral against the published poses, and what a NeRF-synthetic loader expects."""

import json
from pathlib import Path

import numpy as np
import pytest

from dataset_gen import cameras as views
from dataset_gen.cameras import CAMERA_ANGLE_X, focal_length, train_cameras, transforms

# Data of [3DMM], where a checkout has it beside it; the table below stands in for it elsewhere.
PUBLISHED = Path(__file__).resolve().parents[3] / "shared/data/mic_5Hz_000"
# From transforms_train.json and transforms_test.json there: position of the camera, as written.
TRAIN_29 = (1.14926028, 2.58125353, 2.87512302)
TEST_8 = (2.96205878, -2.39862895, 1.31254947)


def test_known_positions_of_the_published_set():
    np.testing.assert_allclose(train_cameras(30)[29].camera_to_world[:3, 3], TRAIN_29, atol=1e-5)
    np.testing.assert_allclose(views.test_cameras(5)[4].camera_to_world[:3, 3], TEST_8, atol=1e-5)


@pytest.mark.skipif(not PUBLISHED.exists(), reason="the published data is not here")
@pytest.mark.parametrize(
    ("split", "cameras"), [("train", train_cameras(30)), ("test", views.test_cameras(5))]
)
def test_poses_equal_the_published_ones(split, cameras):
    published = json.loads((PUBLISHED / f"transforms_{split}.json").read_text())
    assert published["camera_angle_x"] == CAMERA_ANGLE_X
    assert len(published["frames"]) == len(cameras)
    for frame, camera in zip(published["frames"], cameras, strict=True):
        assert frame["file_path"] == f"./{split}/{camera.name}"
        assert frame["rotation"] == pytest.approx(camera.rotation, abs=1e-7)
        np.testing.assert_allclose(camera.camera_to_world, frame["transform_matrix"], atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 10, 12])
def test_test_views_are_distinct_and_as_many_as_asked(count):
    cameras = views.test_cameras(count)
    assert len({camera.name for camera in cameras}) == count


@pytest.mark.parametrize("camera", train_cameras(7))
def test_cameras_are_rotations_that_look_at_the_origin(camera):
    rotation, position = camera.camera_to_world[:3, :3], camera.camera_to_world[:3, 3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(-rotation[:, 2], -position / np.linalg.norm(position), atol=1e-12)
    assert rotation[2, 1] > 0  # upright


def test_transforms_have_the_original_keys_and_a_time():
    data = transforms(train_cameras(3), "train", 0.5, 128, 128)
    assert data["camera_angle_x"] == CAMERA_ANGLE_X
    assert data["fl_x"] == pytest.approx(0.5 * 128 / np.tan(CAMERA_ANGLE_X / 2))
    assert data["fl_x"] == focal_length(128)
    assert [frame["file_path"] for frame in data["frames"]] == [
        "./train/r_000",
        "./train/r_001",
        "./train/r_002",
    ]
    assert all(frame["time"] == 0.5 for frame in data["frames"])
    assert json.loads(json.dumps(data)) == data
