"""When a capture's pictures were taken, and of what kind it is."""

import json
import logging
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.capture.conftest import edit, write_folder
from tg4mm.capture import Capture, load_capture
from tg4mm.capture.model import check_times, kind_of_cameras
from tg4mm.capture.sfm.clip import find_sources
from tg4mm.capture.transforms import whole_dataset
from tg4mm.core.choices import KINDS
from tg4mm.core.errors import CaptureError
from tg4mm.core.magnification import check_band
from tg4mm.run.train import _capture

STEPS = list(range(20))
KINDS_OF_CAMERAS = [  # timesteps of each camera, timesteps in all
    ({0: [0], 1: [0]}, 1, "photos"),
    ({0: STEPS, 1: [0], 2: [0]}, 20, "tripod"),
    ({0: STEPS, 1: STEPS}, 20, "rig"),
    ({t: [t] for t in STEPS}, 20, "handheld"),
    ({0: STEPS, 1: STEPS[:19]}, 20, "rig"),  # a camera that misses one of many stayed
    ({0: STEPS, 1: STEPS[:10]}, 20, "tripod"),
]

STEP = 1 / 30
DROPPED = np.array([0, 1, 2, 3, 5, 6, 7, 8, 11, 12]) * STEP
AGREE = {  # times, timesteps, cameras, frames per second
    "dropped frames": (DROPPED, np.arange(10), "a" * 10, 30.0),
    "NTSC and its rounding": (np.arange(30) * 1001 / 30000, np.arange(30), "a" * 30, 29.97),
    "every tenth timestep": (np.arange(4) * 10 * STEP, np.arange(4) * 10, "a" * 4, 30.0),
    "clocks of their own": (
        np.concatenate([np.arange(5) * STEP, 100 + np.arange(5) * STEP]), np.tile(np.arange(5), 2),
        "a" * 5 + "b" * 5, 30.0,
    ),
}  # fmt: skip


def of_cameras(cameras, n_timesteps):
    """The kind of a capture in which each camera has pictures at these timesteps."""
    ids = [camera for camera, timesteps in cameras.items() for _ in timesteps]
    times = [t for timesteps in cameras.values() for t in timesteps]
    return kind_of_cameras(np.array(ids), np.array(times), n_timesteps)


def retime(tree, times, split="train"):
    """Give the frames of each timestep this time; None takes it away."""
    for t, time_s in times.items():
        path = tree / f"{t:03d}" / f"transforms_{split}.json"
        values = json.loads(path.read_text())
        for frame in values["frames"]:
            frame.pop("time", None)
            if time_s is not None:
                frame["time"] = time_s
        path.write_text(json.dumps(values))


class TestKind:
    @pytest.mark.parametrize(("cameras", "n_timesteps", "kind"), KINDS_OF_CAMERAS)
    def test_cameras_that_stay_are_counted(self, cameras, n_timesteps, kind):
        assert of_cameras(cameras, n_timesteps) == kind

    def test_scene_json_has_the_last_word(self, tree):
        assert load_capture(tree).kind == "rig"
        for kind in KINDS:
            edit(tree / "scene.json", lambda v, kind=kind: v.update(kind=kind))
            assert load_capture(tree).kind == kind


class TestTimes:
    def test_the_frames_own_times_are_taken(self, tree):
        retime(tree, {0: 7.0, 1: 7.0332, 2: 7.0668})
        np.testing.assert_array_equal(load_capture(tree).times_s, [7.0, 7.0, 7.0332, 7.0332, 7.0668, 7.0668])

    def test_without_any_they_follow_from_the_frame_rate(self, tree):
        retime(tree, dict.fromkeys(range(3)))
        np.testing.assert_allclose(load_capture(tree).times_s, np.array([0, 0, 1, 1, 2, 2]) / 30)

    def test_a_picture_of_the_scene_at_rest_has_none(self, tree):
        write_folder(tree / "000", "train", views=3)
        path = tree / "000" / "transforms_train.json"
        edit(path, lambda v: v["frames"][2].pop("time"))
        times = load_capture(tree).times_s
        assert np.isnan(times).tolist() == [False, False, True, False, False, False, False]

    def test_a_later_picture_needs_one(self, tree):
        path = tree / "001" / "transforms_train.json"
        edit(path, lambda v: v["frames"][1].pop("time"))
        with pytest.raises(CaptureError, match=r"r_001\.png: its frame has no time, though others have"):
            load_capture(tree)

    def test_an_edited_frame_rate_is_refused_with_both_numbers(self, tree):
        (tree / "scene.json").write_text('{"fps": 60}')
        said = r"scene\.json: fps is 60, but the times of camera r_000 step by 0\.0333333 s \(30 Hz\)"
        with pytest.raises(CaptureError, match=said):
            load_capture(tree)

    def test_numbered_pictures_show_it_too(self, tree):
        """No name comes back in a later timestep, so no camera's own steps can be looked at."""
        for t in range(3):
            path = tree / f"{t:03d}" / "transforms_train.json"
            values = json.loads(path.read_text())
            for i, frame in enumerate(values["frames"]):
                old = path.parent / f"{frame['file_path']}.png"
                frame["file_path"] = f"./train/frame_{t}_{i}"
                old.rename(path.parent / f"{frame['file_path']}.png")
            path.write_text(json.dumps(values))
        retime(tree, {0: 0.0, 1: 1 / 30, 2: 2 / 30})
        assert load_capture(tree).fps == 30
        (tree / "scene.json").write_text('{"fps": 300}')
        said = r"fps is 300, but the times of the pictures step by .* \(30 Hz\)"
        with pytest.raises(CaptureError, match=said):
            load_capture(tree)

    def test_times_that_stand_still_are_refused(self, tree):
        retime(tree, dict.fromkeys(range(3), 0.0))
        with pytest.raises(CaptureError, match=r"fps is 30, .* step by 0 s \(no frame rate\)"):
            load_capture(tree)

    def test_a_lone_timestep_with_a_late_time_is_none_of_our_business(self, folder):
        (folder / "scene.json").write_text('{"fps": 12}')
        assert load_capture(folder).times_s.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("what", AGREE)
def test_times_agree_with_the_frame_rate(what):
    times, timesteps, cameras, fps = AGREE[what]
    check_times("scene.json", times, timesteps, list(cameras), fps)
    with pytest.raises(CaptureError):
        check_times("scene.json", times, timesteps, list(cameras), 0.96 * fps)


def test_the_camera_whose_times_are_wrong_is_named():
    times = np.concatenate([np.arange(2) / 30, np.arange(2) / 25])
    with pytest.raises(CaptureError, match=r"the times of camera b step by 0\.04 s \(25 Hz\)"):
        check_times("scene.json", times, np.tile(np.arange(2), 2), ["a"] * 2 + ["b"] * 2, 30.0)


def test_a_capture_made_by_hand_gets_kind_and_times():
    capture = Capture(
        Path(), "train", 4, 4, 10.0, 3, np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(3), (3, 1, 1)),
        np.arange(3), np.zeros(3, int), (Path("a"),) * 3,
    )  # fmt: skip
    assert capture.kind == "tripod"
    np.testing.assert_allclose(capture.times_s, [0, 0.1, 0.2])
    assert math.isclose(capture.times_s[2], 0.2)


def test_a_wrong_length_or_kind_is_refused():
    arrays = (np.eye(4)[None], np.eye(3)[None], np.zeros(1, int), np.zeros(1, int), (Path("a"),))
    with pytest.raises(ValueError, match=r"times_s has shape \(2,\), expected \(1,\)"):
        Capture(Path(), "train", 4, 4, 0.0, 1, *arrays, times_s=np.zeros(2))
    with pytest.raises(ValueError, match="kind is 'x', expected one of photos"):
        Capture(Path(), "train", 4, 4, 0.0, 1, *arrays, kind="x")


def test_a_timestep_and_its_pictures_are_parts(tree, monkeypatch):
    root = tree.resolve()
    assert whole_dataset(tree / "001") == (root, f"timestep 001 of the dataset {root}")
    pictures = f"the train pictures, timestep 001, of the dataset {root}"
    assert whole_dataset(tree / "001" / "train") == (root, pictures)
    monkeypatch.chdir(tree / "001" / "train")
    assert whole_dataset(Path(".")) == (root, pictures)


def test_whole_datasets_and_other_folders_are_not(tree, folder, tmp_path):
    (tmp_path / "photos" / "train").mkdir(parents=True)
    for other in (tree, folder, tmp_path, tmp_path / "photos", tmp_path / "photos" / "train"):
        assert whole_dataset(other) is None
    root = folder.resolve()
    assert whole_dataset(folder / "train") == (root, f"the train pictures of the dataset {root}")


def test_training_pictures_alone_is_refused(tree, folder):
    for part, root in ((tree / "000" / "train", tree), (folder / "train", folder)):
        said = rf"train: is not a dataset but .*; run tg4mm train {root.resolve()} --out RUN"
        with pytest.raises(CaptureError, match=said):
            _capture(part)


def test_training_one_timestep_is_said(tree, caplog):
    with caplog.at_level(logging.WARNING, "tg4mm"):
        assert _capture(tree / "000").n_timesteps == 1
    (line,) = caplog.messages
    assert f"is timestep 000 of the dataset {tree.resolve()}, by itself a still scene" in line
    caplog.clear()
    _capture(tree)
    assert caplog.messages == []


def test_sfm_takes_no_part_of_a_dataset(tree):
    for part in (tree / "000", tree / "000" / "train"):
        with pytest.raises(CaptureError, match="whose poses are known: tg4mm train"):
            find_sources(part)
    with pytest.raises(CaptureError, match="is a dataset already: tg4mm train"):
        find_sources(tree)


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.floats(1e-3, 1e6))
def test_a_band_passes_exactly_if_it_lies_below_half_the_frame_rate(low, high, fps):
    if 0 <= low < high < fps / 2:
        assert check_band((low, high), fps) == (low, high)
    else:
        with pytest.raises(CaptureError, match="band"):
            check_band((low, high), fps)


@pytest.mark.parametrize(
    ("band", "fps", "message"),
    [
        ((4.0, 40.0), 30, r"band \(4, 40\) Hz reaches past half the frame rate, 15 Hz \(fps = 30\)"),
        ((4.0, 15.0), 30, "reaches past half the frame rate, 15 Hz"),
        ((-1, 4), 30, r"band \(-1, 4\) Hz starts below 0 Hz"),
        ((4, 4), 30, r"band \(4, 4\) Hz is empty"),
        ((5, 4), 30, "low must be below high"),
        ((math.nan, 4), 30, r"band \(nan, 4\) is not two frequencies"),
        ((1, math.inf), 30, "is not two frequencies"),
        ((1, 2, 3), 30, "is not two frequencies"),
        ("12", 30, "band '12' is not two frequencies"),
        (None, 30, "band None is not two frequencies"),
        ((1, 2), 0.0, r"band \(1, 2\) Hz needs a frame rate, and fps is 0"),
        ((1, 2), math.nan, "fps is nan"),
    ],
)
def test_a_bad_band_is_refused_with_its_numbers(band, fps, message):
    with pytest.raises(CaptureError, match=message):
        check_band(band, fps)
