"""Clocks of cameras, clips and the flat kind: what is at which time where, and what scene.json calls it."""

from dataclasses import replace

import numpy as np
import pytest

from dataset_gen.cameras import CameraSetup, cameras_at, clock_offsets, films, scene_time, train_cameras
from dataset_gen.errors import GenerateError

RIG = CameraSetup("rig", views=6, clock_offset_s=0.4)
CLIPS = CameraSetup("clips", views=7, n_timesteps=75)
FLAT = CameraSetup("flat", test_views=5)
SWEEP = CameraSetup("sweep", views=4)


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


def test_clips_are_one_camera_in_places_all_around():
    cameras = cameras_at(CLIPS, 0)["train"]
    assert cameras == cameras_at(CLIPS, 74)["train"]
    assert [camera.name for camera in cameras] == [f"r_{i:03d}" for i in range(7)]
    assert len({camera.angle_x for camera in cameras}) == 1  # one lens
    places = np.array([camera.position for camera in cameras])
    assert np.linalg.norm(places[:, None] - places, axis=-1)[~np.eye(7, dtype=bool)].min() > 1.0


def test_a_sweep_shows_the_scene_at_rest_and_has_no_time():
    fixed, *sweep = cameras_at(SWEEP, 0)["train"]
    assert scene_time(SWEEP, fixed, 5) == pytest.approx(5 / 30)
    assert films(SWEEP, fixed)
    assert len(sweep) == 4
    assert {scene_time(SWEEP, camera, 0) for camera in sweep} == {None}
    assert not any(films(SWEEP, camera) for camera in sweep)
    assert clock_offsets(SWEEP) == (0.0,)


@pytest.mark.parametrize(
    ("setup", "kind"),
    [
        (CameraSetup(), "rig"),
        (RIG, "rig"),
        (SWEEP, "tripod"),
        (CameraSetup("handheld"), "handheld"),
        (CLIPS, "clips"),
        (FLAT, "flat"),
        (CameraSetup("given", given=(train_cameras(3)[0],)), "flat"),
        (replace(RIG, n_timesteps=1), "photos"),
    ],
)
def test_kind_of_capture(setup, kind):
    assert setup.capture_kind == kind


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clock_offset_s": -1.0}, r"--clock-offsets -1.0 is not in 0 … 10000 seconds"),
        ({"clock_offset_s": float("nan")}, r"--clock-offsets nan"),
        (
            {"kind": "clips", "clock_offset_s": 0.1},
            r"--clock-offsets 0.1: with --cameras clips no two cameras",
        ),
        (
            {"kind": "sweep", "clock_offset_s": 0.1},
            r"--clock-offsets 0.1: with --cameras sweep no two cameras",
        ),
    ],
)
def test_unusable_clocks_are_refused(changes, message):
    with pytest.raises(GenerateError, match=message):
        CameraSetup(**changes)
