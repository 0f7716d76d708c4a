"""Datasets for other trainers: read back by pycolmap, and by the readers of those layouts."""

import numpy as np
import pycolmap
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.capture.convert import at_timesteps
from tg4mm.cli import main

T = 4


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Three training and two test cameras, four timesteps, points."""
    root = tmp_path_factory.mktemp("convert") / "data"
    make_synthetic_dataset(root, n_views=3, n_timesteps=T, size=16, n_test=2)
    return root


def convert(dataset, out, to, *options):
    return main(["convert", str(dataset), "--out", str(out), "--to", to, *options])


def test_pycolmap_reads_cameras_poses_and_points(dataset, tmp_path):
    assert convert(dataset, tmp_path / "c", "colmap") == 0
    model = pycolmap.Reconstruction(str(tmp_path / "c" / "sparse" / "0"))
    capture = load_capture(dataset)
    rows = {path.relative_to(dataset).as_posix(): i for i, path in enumerate(capture.paths)}
    assert {image.name for image in model.images.values()} == set(rows)
    for image in model.images.values():
        i = rows[image.name]
        np.testing.assert_allclose(image.cam_from_world().matrix(), capture.viewmats[i][:3], atol=1e-12)
        camera = model.cameras[image.camera_id]
        assert (camera.model.name, camera.width, camera.height) == ("PINHOLE", 16, 16)
        np.testing.assert_allclose(camera.calibration_matrix(), capture.Ks[i], atol=1e-12)
        assert (tmp_path / "c" / "images" / image.name).read_bytes() == capture.paths[i].read_bytes()
    assert len(model.cameras) == 1  # all lenses are alike
    spots = [model.points3D[i] for i in sorted(model.points3D)]
    np.testing.assert_allclose([spot.xyz for spot in spots], capture.points.xyz)
    np.testing.assert_array_equal([spot.color for spot in spots], capture.points.rgb)


def test_nerfstudio_times_are_read_back(dataset, tmp_path):
    assert convert(dataset, tmp_path / "n", "nerfstudio") == 0
    read, want = load_capture(tmp_path / "n"), load_capture(dataset)
    assert (read.n_timesteps, read.fps, len(read)) == (want.n_timesteps, want.fps, len(want))
    np.testing.assert_array_equal(np.sort(read.timesteps), np.sort(want.timesteps))
    rows = {path.relative_to(want.root).as_posix(): i for i, path in enumerate(want.paths)}
    order = [rows[path.relative_to(read.root / "images").as_posix()] for path in read.paths]
    np.testing.assert_allclose(read.times_s, want.times_s[order], atol=1e-9)
    np.testing.assert_array_equal(read.timesteps, want.timesteps[order])


def test_a_killed_conversion_goes_on_and_another_one_is_refused(dataset, tmp_path, capsys):
    out = tmp_path / "n"
    assert convert(dataset, out, "nerfstudio") == 0
    before = {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    (out / "transforms.json").unlink()
    next((out / "images").rglob("*.png")).unlink()
    assert convert(dataset, out, "nerfstudio") == 0
    assert {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file()} == before
    capsys.readouterr()
    for words, message in (
        ("colmap", 'layout = "nerfstudio"'),
        ("nerfstudio --timesteps 1", "other pictures"),
    ):
        assert convert(dataset, out, *words.split()) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize("split", ["train", "test"])
def test_nerfstudio_poses_lenses_and_points_are_read_back(dataset, tmp_path, split):
    assert convert(dataset, tmp_path / "n", "nerfstudio", "--timesteps", "0-1") == 0
    read = load_capture(tmp_path / "n", split=split)
    want = at_timesteps(load_capture(dataset, split=split), [0, 1])
    order = np.argsort([path.as_posix() for path in read.paths])
    np.testing.assert_allclose(read.viewmats[order], want.viewmats, atol=1e-9)
    np.testing.assert_allclose(read.Ks[order], want.Ks, atol=1e-9)
    np.testing.assert_allclose(read.points.xyz, want.points.xyz)


def test_bad_input_is_one_line(dataset, tmp_path, capsys):
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine").touch()
    for arguments, message in (
        ((dataset, full, "colmap"), "is not empty and holds no tg4mm.json, but 'mine'"),
        ((dataset, full / "mine", "colmap"), "is a file, expected a folder"),
        (
            (dataset, tmp_path / "x", "colmap", "--timesteps", "9"),
            "has no image at timestep 9; there are 0 … 3",
        ),
        ((tmp_path / "none", tmp_path / "x", "colmap"), "does not exist"),
    ):
        assert convert(*arguments) == 2
        line = capsys.readouterr().err
        assert message in line
        assert line.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full"]
