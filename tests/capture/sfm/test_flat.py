"""One fixed camera and nothing else: a plane at distance 1, in pixels."""

import json
import shutil
from fractions import Fraction

import numpy as np
import pytest

from tests.capture.sfm.videos import SIZE, still, write_video
from tg4mm.capture import load_capture
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.reconstruct import reconstruct
from tg4mm.cli import main
from tg4mm.core.errors import Tg4mmError

T = 12


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    return write_video(tmp_path_factory.mktemp("in") / "bridge.mp4", still(T), Fraction(30000, 1001))


@pytest.fixture(scope="module")
def dataset(video, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "bridge"
    assert main(["sfm", str(video), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def capture(dataset):
    return load_capture(dataset)


def test_it_is_a_capture_of_one_camera_with_exact_times(dataset, capture):
    assert (capture.kind, capture.n_timesteps, capture.unit_scale_m) == ("flat", T, None)
    assert capture.fps == float(Fraction(30000, 1001))
    assert json.loads((dataset / "scene.json").read_text())["fps"] == float(Fraction(30000, 1001))
    assert set(capture.camera_ids.tolist()) == {0}
    assert capture.times_s.tolist() == [float(k * Fraction(1001, 30000)) for k in range(T)]
    assert [path.name for path in capture.paths] == [f"bridge.mp4#{k}" for k in range(T)]
    assert not list(dataset.glob("*/train"))


def test_the_camera_is_upright_at_the_origin_and_looks_along_y(capture):
    viewmat, K = capture.viewmats[0], capture.Ks[0]
    focal = max(SIZE)
    np.testing.assert_allclose(K, [[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1]])
    for world, pixel in (
        ((0, 1, 0), (SIZE[0] / 2, SIZE[1] / 2)),
        ((0.1, 1, 0), (SIZE[0] / 2 + 0.1 * focal, SIZE[1] / 2)),
        ((0, 1, 0.1), (SIZE[0] / 2, SIZE[1] / 2 - 0.1 * focal)),
    ):
        q = K @ (viewmat[:3, :3] @ np.array(world) + viewmat[:3, 3])
        np.testing.assert_allclose(q[:2] / q[2], pixel)
    assert json.loads((capture.root / "scene.json").read_text())["pixels_per_unit"] == focal


def test_slow_motion_gets_the_rate_it_was_filmed_at(video, dataset, tmp_path):
    out = tmp_path / "bridge"
    shutil.copytree(dataset, out)
    reconstruct(video, out, SfmConfig(fps=240.0))
    capture = load_capture(out)
    assert capture.fps == 240.0
    np.testing.assert_allclose(capture.times_s, np.arange(T) / 240)


def test_the_readout_of_rows_is_written_without_the_dataset_made_again(video, dataset, tmp_path):
    out = tmp_path / "bridge"
    shutil.copytree(dataset, out)
    before = (out / "video" / "bridge.mp4").stat().st_mtime_ns
    assert load_capture(out).readout_s == 0
    assert main(["sfm", str(video), "--out", str(out), "--readout", "12.5"]) == 0
    assert load_capture(out).readout_s == 0.0125
    assert main(["sfm", str(video), "--out", str(out)]) == 0
    assert "readout_s" not in json.loads((out / "scene.json").read_text())
    assert (out / "video" / "bridge.mp4").stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("40", "--readout is 40, expected at most the 33.37 ms of a frame of bridge.mp4"),
        ("-5", "--readout is -5.0, expected"),
        ("nan", "--readout is nan, expected"),
        ("12 --kind handheld", "--readout is for fixed cameras, but"),
    ],
)
def test_a_readout_that_cannot_be_is_refused(video, tmp_path, capsys, options, said):
    assert main(["sfm", str(video), "--out", str(tmp_path / "out"), "--readout", *options.split()]) == 2
    assert said in capsys.readouterr().err.splitlines()[-1]


def test_rows_of_a_turned_video_have_no_readout(tmp_path):
    turned = write_video(tmp_path / "phone.mp4", still(T), 30, rotation=90)
    with pytest.raises(Tg4mmError, match=r"stored upright, but phone\.mp4 is rotated"):
        reconstruct(turned, tmp_path / "out", SfmConfig(readout_s=0.0125))


def test_what_makes_no_sense_is_refused(video, tmp_path):
    for config, said in (
        (SfmConfig(unit_scale_m=1.0), "a flat capture is measured in pixels"),
        (SfmConfig(test_every=4), "--test-every is 4, but flat has no camera to hold out"),
        (SfmConfig(kind="tripod"), "--kind is tripod, but .* holds one recording, which can be flat or"),
    ):
        with pytest.raises(Tg4mmError, match=said):
            reconstruct(video, tmp_path / said[2:6].strip(), config)
