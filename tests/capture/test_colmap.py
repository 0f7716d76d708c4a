"""COLMAP folders: files as pycolmap writes them and by hand, and what is refused."""

import logging
import os
import shutil

import numpy as np
import pytest

from tests.capture.conftest import refused
from tests.helpers.colmap import CAMERAS, IMAGES, NAMES, POINTS, pictures
from tg4mm.capture import load_capture, load_images


@pytest.fixture
def text(tmp_path):
    """A COLMAP folder with a text model."""
    root = pictures(tmp_path / "colmap")
    sparse = root / "sparse" / "0"
    sparse.mkdir(parents=True)
    for name, content in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", POINTS)):
        (sparse / f"{name}.txt").write_text(content)
    return root


def edit(path, old, new):
    content = path.read_text()
    assert old in content
    path.write_text(content.replace(old, new))


def check(root):
    capture = load_capture(root)
    assert [p.relative_to(root / "images").as_posix() for p in capture.paths] == list(NAMES)
    # x y z w → a third of a turn about (1, 1, 1): x to y, y to z, z to x
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(capture.viewmats[0, :3, :3], turn, atol=1e-12)
    np.testing.assert_allclose(capture.viewmats[0, :3, 3], [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(capture.viewmats[1], [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]])
    np.testing.assert_allclose(capture.viewmats[2, :3, :3], np.diag([-1.0, 1, -1]), atol=1e-12)
    assert capture.Ks[0].tolist() == [[20, 0, 6], [0, 21, 4.5], [0, 0, 1]]
    assert capture.Ks[1].tolist() == [[25, 0, 6], [0, 25, 4], [0, 0, 1]]
    assert (capture.n_timesteps, capture.fps, capture.unit_scale_m) == (1, 0.0, None)
    assert load_images(capture).data[:, 0, 0, 0].tolist() == [100, 101, 102]
    points = capture.points
    assert points.xyz.tolist() == [[1.5, 2.5, 3.5], [-1, 0, 1]]
    assert points.rgb.tolist() == [[10, 20, 30], [200, 100, 0]]
    assert (points.xyz.dtype, points.rgb.dtype) == (np.float64, np.uint8)


def test_models_in_text_by_hand_and_in_either_form_as_pycolmap_writes_them(text):
    check(text)
    pycolmap = pytest.importorskip("pycolmap")
    sparse = text / "sparse" / "0"
    model = pycolmap.Reconstruction(sparse)
    model.write_text(sparse)
    check(text)
    for path in sparse.iterdir():
        path.unlink()
    model.write_binary(sparse)
    assert {p.name for p in sparse.iterdir()} >= {"cameras.bin", "images.bin", "points3D.bin"}
    check(text)


def test_the_undistorters_layout_has_no_number(text):
    for path in (text / "sparse" / "0").iterdir():
        shutil.move(path, text / "sparse")
    (text / "sparse" / "0").rmdir()
    check(text)


def test_a_name_with_a_space_and_one_without_a_rotation_s_last_digit(text):
    os.replace(text / "images/b.png", text / "images/b 1.png")
    edit(text / "sparse/0/images.txt", "b.png", "b 1.png")
    edit(text / "sparse/0/images.txt", "0.5 0.5 0.5 0.5", "0.5 0.5 0.5 0.5002")
    capture = load_capture(text)
    assert capture.paths[2].name == "b 1.png"
    rotation = capture.viewmats[0, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("file", "old", "new", "parts"),
    [
        ("cameras", "PINHOLE 12 8 20 21", "OPENCV_FISHEYE 12 8 20 21", ("OPENCV_FISHEYE", "8")),
        ("cameras", "1 PINHOLE", "1 OTHER", ("1 is OTHER, of which pycolmap makes no pinhole", "tg4mm sfm")),
        ("cameras", "PINHOLE 12 8 20 21 6 4.5", "EQUIRECTANGULAR 12 8 12 8", ("EQUIRECTANGULAR, of which",)),
        ("cameras", "1 PINHOLE", "5 PINHOLE", ("belongs to camera 1, which the model does not define",)),
        ("cameras", "12 8 20", "13 8 20", ("w is 13; expected 12",)),
        ("cameras", "21 6 4.5", "21 6", ("cameras.txt: is truncated or damaged", "3 parameters, not 4")),
        ("cameras", "20 21 6 4.5", "-20 21 6 4.5", ("fl_x is -20.0",)),
        ("images", "0.5 0.5 0.5 0.5 1", "0.5 0.5 0.5 2 1", ("image 1: has the pose [0.5, 0.5, 0.5, 2.0",)),
        ("images", "1 2 3 1 a", "1 nan 3 1 a", ("image 1: has the pose",)),
        ("images", "a/r_2.png", "../../x.png", ("leads outside the dataset's folder",)),
        ("images", "1 2 3 1 a", "1 x 3 1 a", ("images.txt: is truncated or damaged",)),
        ("images", IMAGES, "# none\n", ("holds no registered image",)),
        ("points3D", "1.5 2.5", "inf 2.5", ("points3D.txt: holds a point that is not finite",)),
    ],
)
def test_bad_models_are_refused(text, file, old, new, parts):
    edit(text / "sparse" / "0" / f"{file}.txt", old, new)
    refused(text, *parts)


def test_of_several_models_the_largest_is_taken_and_said(text, caplog):
    sparse = text / "sparse"
    small = shutil.copytree(sparse / "0", sparse / "2") / "images.txt"
    shutil.copytree(sparse / "0", sparse / "1")
    for folder in ("0", "2"):
        lines = [line for line in IMAGES.splitlines(keepends=True) if not line.startswith("#")]
        (sparse / folder / "images.txt").write_text("".join(lines[:2]))
    assert small.is_file()
    with caplog.at_level(logging.WARNING, "tg4mm"):
        check(text)
        check(text)
    said = "sparse: holds 3 models, with pictures: 0 (1), 1 (3), 2 (1); the largest, 1, is taken"
    assert caplog.text.count(said) == 1


@pytest.mark.parametrize(
    "place", ["sparse/model_a", "sparse/0/1", "colmap/sparse/0", "colmap/sparse", "colmap", "."]
)
def test_models_in_other_programs_folders(text, place):
    folder = shutil.move(text / "sparse" / "0", text / "moved")
    (text / "sparse").rmdir()
    shutil.copytree(folder, text / place, dirs_exist_ok=True)
    shutil.rmtree(folder)
    check(text)


def test_a_damaged_model_is_not_the_largest(text, caplog):
    shutil.copytree(text / "sparse" / "0", text / "sparse" / "1")
    (text / "sparse" / "0" / "images.txt").write_text("1 0 0\n")
    with caplog.at_level(logging.WARNING, "tg4mm"):
        check(text)
    assert "0 (damaged), 1 (3); the largest, 1, is taken" in caplog.text


def test_a_text_model_with_a_byte_order_mark_and_windows_line_ends(text):
    for path in (text / "sparse" / "0").iterdir():
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    check(text)


def test_missing_pictures_are_left_out_and_counted_unless_they_are_half(text, caplog):
    images = text / "images"
    (images / NAMES[1]).unlink()
    with caplog.at_level(logging.WARNING, "tg4mm"):
        assert len(load_capture(text).paths) == 2
    assert "1 of 3 pictures are missing and left out" in caplog.text
    (images / NAMES[0]).unlink()
    refused(text, "does not exist", "2 of 3 pictures are missing")


def test_names_with_backslashes_are_those_of_windows(text):
    edit(text / "sparse/0/images.txt", "a/r_2.png", "a\\r_2.png")
    check(text)
    edit(text / "sparse/0/images.txt", "a\\r_2.png", "..\\..\\x.png")
    refused(text, "leads outside the dataset's folder")
