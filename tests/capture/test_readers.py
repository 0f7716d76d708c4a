"""Good datasets: what is read from a folder, a tree, magnified ground truth, and everything optional."""

import math
import os
import shutil

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData, PlyElement

from tests.capture.conftest import ANGLE_X, SIZE, edit
from tg4mm.capture import load_capture, load_images


def test_a_single_folder_is_one_timestep_of_unknown_fps_and_scale(folder):
    capture = load_capture(folder)
    assert (capture.n_timesteps, capture.fps, capture.unit_scale_m) == (1, 0.0, None)
    assert (capture.width, capture.height) == SIZE
    assert (capture.points, capture.scene, capture.root) == (None, {}, folder)
    assert capture.timesteps.tolist() == [0, 0]
    assert capture.times_s.tolist() == [0.0, 0.0]


def test_intrinsics_come_from_the_horizontal_field_of_view(folder):
    width, height = SIZE
    focal = width / 2 / math.tan(ANGLE_X / 2)
    expected = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
    np.testing.assert_allclose(load_capture(folder).Ks, [expected, expected], rtol=1e-14)


def test_a_frame_s_own_intrinsics_win_over_the_file_s(folder):
    def change(values):
        values.update(fl_x=20.0, fl_y=21.0, cx=5.5, cy=4.5, w=12, h=8, k1=0.0)
        values["frames"][1].update(fl_x=30.0, cx=6.5)

    edit(folder / "transforms_train.json", change)
    first, second = load_capture(folder).Ks
    assert first.tolist() == [[20, 0, 5.5], [0, 21, 4.5], [0, 0, 1]]
    assert second.tolist() == [[30, 0, 6.5], [0, 21, 4.5], [0, 0, 1]]


def test_a_tree_gives_every_timestep_in_order(tree):
    capture = load_capture(tree)
    assert (capture.fps, capture.n_timesteps, capture.split) == (30.0, 3, "train")
    assert capture.timesteps.tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_allclose(capture.times_s, np.array([0, 0, 1, 1, 2, 2]) / 30)
    names = [path.relative_to(tree).as_posix() for path in capture.paths]
    assert names == [f"{t:03d}/train/r_{i:03d}.png" for t in range(3) for i in range(2)]
    assert load_images(capture).data[:, 0, 0, 0].tolist() == [100, 101, 110, 111, 120, 121]


def test_a_camera_that_stays_is_one_id(tree):
    capture = load_capture(tree)
    assert capture.camera_ids.tolist() == [0, 1, 0, 1, 0, 1]
    edit(tree / "002" / "transforms_train.json", lambda v: v.update(camera_angle_x=0.71))
    assert load_capture(tree).camera_ids.tolist() == [0, 1, 0, 1, 2, 3]


def test_magnification_reads_the_ground_truth_of_the_test_cameras(tree):
    capture = load_capture(tree, magnification=5)
    assert (capture.split, capture.n_timesteps, capture.fps, capture.root) == ("test", 3, 30.0, tree)
    assert load_images(capture).data[:, 0, 0, 0].tolist() == [200, 210, 220]
    assert load_capture(tree, magnification=5.0).paths == capture.paths
    np.testing.assert_array_equal(capture.viewmats, load_capture(tree, "test").viewmats)


@pytest.mark.parametrize("gone", [0, 1, 2])
def test_ground_truth_may_lack_timesteps(tree, gone):
    whole = load_capture(tree, magnification=5)
    pictures = load_images(whole).data
    shutil.rmtree(tree / f"magnified/x005/{gone:03d}")
    (tree / "scene.json").write_text('{"fps": 30, "n_timesteps": 3}')
    capture = load_capture(tree, magnification=5)
    kept = whole.timesteps != gone
    assert capture.n_timesteps == 3
    assert capture.timesteps.tolist() == whole.timesteps[kept].tolist()
    np.testing.assert_array_equal(load_images(capture).data, pictures[kept])


@pytest.mark.parametrize(("colours", "text"), [("rgb", False), ("rgb", True), ("", False)])
def test_points_with_colours_and_without_which_are_grey(tree, colours, text):
    names = {"r": "red", "g": "green", "b": "blue"}
    data = np.zeros(4, [*((axis, "f4") for axis in "xyz"), *((names[c], "u1") for c in colours)])
    data["x"] = [1, 2, 3, 4]
    if colours:
        data["green"] = [10, 20, 30, 40]
    PlyData([PlyElement.describe(data, "vertex")], text=text).write(str(tree / "points3d.ply"))
    points = load_capture(tree).points
    assert points.xyz.dtype == np.float32
    assert points.xyz.tolist() == [[i, 0, 0] for i in (1, 2, 3, 4)]
    assert points.rgb.tolist() == [[0, g, 0] if colours else [128] * 3 for g in (10, 20, 30, 40)]


def test_images_are_in_natural_order_of_their_names(folder):
    def change(values):
        for frame, name in zip(values["frames"], ("r_10", "r_2"), strict=True):
            os.replace(folder / f"{frame['file_path']}.png", folder / "train" / f"{name}.png")
            frame["file_path"] = f"train/{name}"

    edit(folder / "transforms_train.json", change)
    assert [path.name for path in load_capture(folder).paths] == ["r_2.png", "r_10.png"]


@pytest.mark.parametrize(
    ("file", "written"),
    [("a.png", "a.png"), ("a.jpg", "a"), ("a.jpeg", "a"), ("a.JPG", "a.JPG"), ("a_0.05.png", "a_0.05")],
)
def test_suffixes_are_tried_when_the_path_has_none(folder, file, written):
    """A dot in the name is none."""
    Image.open(folder / "train/r_000.png").convert("RGB").save(folder / file, format="PNG")
    edit(folder / "transforms_train.json", lambda v: v["frames"][0].update(file_path=written))
    assert load_capture(folder).paths[0].name == file
