"""Scores of pictures with known answers, video quality by a checkout, and what of a motion can be observed."""

import shutil
import sys

import numpy as np
import pytest
from PIL import Image

from tests.helpers.synthetic import make_synthetic_dataset, with_phasors
from tg4mm.capture import load_capture
from tg4mm.core.magnification import AS_CAPTURED
from tg4mm.core.metrics import ssim_map
from tg4mm.core.pictures.decode import write_png
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.measure import AGREES, agreement, observed_figures, rms_motion
from tg4mm.research.bench.scored import PROGRAMS, cameras_of, checkouts, score_pictures, video_of
from tg4mm.research.bench.sets import open_set
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.evaluate.scores import Subject
from tg4mm.show.maps import blending_weights

VIDEO = np.full((4, 32, 32, 3), 128, np.uint8)


@pytest.fixture(scope="module")
def truth(data):
    return load_capture(data, split="test", magnification=20)


def written(capture, folder, share, offset=0.0):
    """Pictures whose change over time is `share` of the truth's, all brighter by `offset`."""
    for rows in cameras_of(capture):
        video = video_of(capture, rows)
        made = video.mean(0) + share * (video - video.mean(0)) + offset
        for i, image in zip(rows, made, strict=True):
            write_png(folder / capture.paths[i].relative_to(capture.root), image)
    return folder


def test_the_truth_itself_is_perfect(truth):
    scores = score_pictures(truth, truth.root)
    assert (scores["ssim"], scores["psnr_db"], scores["flip"]) == (1.0, 100.0, 0.0)
    assert (scores["ssim_moving"], scores["psnr_moving_db"]) == (1.0, 100.0)
    assert scores["gain"] == pytest.approx(1)
    assert scores["residual"] == pytest.approx(0, abs=1e-6)
    assert scores["n_images"] == len(truth)


def test_moments_without_error_do_not_rule_the_psnr_of_what_moves(truth, tmp_path):
    """Half of the pictures are the truth itself: half of the squared error, 3 dB more, and no mean with 100 dB."""
    whole, half = written(truth, tmp_path / "whole", 0.0), written(truth, tmp_path / "half", 0.0)
    for i in range(0, len(truth), 2):
        own = truth.paths[i]
        (half / own.relative_to(truth.root)).write_bytes(own.read_bytes())
    all_wrong, half_wrong = (score_pictures(truth, f)["psnr_moving_db"] for f in (whole, half))
    assert half_wrong - all_wrong == pytest.approx(3, abs=0.5)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_the_gain_is_the_share_of_the_motion_whatever_stands_still_wrong(truth, tmp_path, share):
    scores = score_pictures(truth, written(truth, tmp_path, share, offset=-0.02))
    assert scores["gain"] == pytest.approx(share, abs=0.02)
    assert scores["residual"] == pytest.approx(0, abs=0.06)


def test_the_residual_is_what_the_motion_does_not_explain(truth, tmp_path):
    """Half of the motion, and noise of its own: by least squares on the files, camera by camera."""
    rng, change, true = np.random.default_rng(0), [], []
    for rows in cameras_of(truth):
        video = video_of(truth, rows)
        noise = rng.normal(0, 0.03, video.shape)
        made = np.clip(video.mean(0) + 0.5 * (video - video.mean(0)) + noise, 0, 1)
        for i, image in zip(rows, made, strict=True):
            write_png(tmp_path / truth.paths[i].relative_to(truth.root), image)
        found = video_of(truth, rows, tmp_path)
        change.append((found - found.mean(0)).ravel())
        true.append((video - video.mean(0)).ravel())
    a, c = np.concatenate(change).astype(np.float64), np.concatenate(true).astype(np.float64)
    (gain,), (squares,), *_ = np.linalg.lstsq(c[:, None], a, rcond=None)
    scores = score_pictures(truth, tmp_path)
    assert scores["gain"] == pytest.approx(gain, rel=1e-5)
    assert scores["residual"] == pytest.approx(np.sqrt(squares / (c @ c)), rel=1e-5)
    assert scores["residual"] > 0.2


def test_what_moves_is_scored_by_itself(truth, tmp_path):
    folder = written(truth, tmp_path, 0.0)
    scores = score_pictures(truth, folder)
    values = []
    for rows in cameras_of(truth):
        video, made = video_of(truth, rows), video_of(truth, rows, folder)
        inside = np.abs(video - video.mean(0)).max((0, 3)) > 8 / 255
        inside[:5], inside[-5:], inside[:, :5], inside[:, -5:] = False, False, False, False
        values += [ssim_map(m, v)[inside].mean() for m, v in zip(made, video, strict=True)]
    assert scores["ssim_moving"] == pytest.approx(np.mean(values))
    assert scores["ssim_moving"] < scores["ssim"]
    assert 0 < scores["moving_share"] < 1


def test_pictures_that_will_not_do(truth, tmp_path):
    folder = written(truth, tmp_path / "made", 1.0)
    first = folder / truth.paths[0].relative_to(truth.root)
    whole = first.read_bytes()
    first.unlink()
    with pytest.raises(BenchError, match=r"r_000.png does not exist"):
        score_pictures(truth, folder)
    Image.new("RGB", (8, 9)).save(first)
    with pytest.raises(BenchError, match=r"is 8×9 pixels, expected 32×32"):
        score_pictures(truth, folder)
    elsewhere = tmp_path / "elsewhere.png"
    elsewhere.write_bytes(whole)
    first.unlink()
    first.symlink_to(elsewhere)
    with pytest.raises(BenchError, match="leads out of its folder"):
        score_pictures(truth, folder)
    shutil.rmtree(folder)


def checkout(folder, metric, program):
    (folder / PROGRAMS[metric][0]).write_text(program)
    (found,) = checkouts({metric: folder}, sys.executable)
    return found


def test_the_two_are_called_as_their_authors_say(tmp_path):
    says = "import sys\nassert open(sys.argv[-1], 'rb').read(12)[4:8] == b'ftyp'\n"
    md = checkout(
        tmp_path, "md_vqa", says + "assert sys.argv[1] == '-i'\nprint('loaded 3 models')\nprint(81.04)\n"
    )
    assert md(VIDEO, 30.0) == 81.04
    line = "print('The quality score of the video (range [0,1]) is 0.20890.', sys.argv[1:4] == [])\n"
    fast = checkout(tmp_path, "fast_vqa", says + "assert sys.argv[1:4] == ['-m', 'FAST-VQA', '-v']\n" + line)
    assert fast(VIDEO, 30.0) == pytest.approx(0.2089)


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("raise SystemExit('no weights')", "status 1: no weights"),
        ("print('none')", "the last line that it printed is 'none', expected one with the score"),
        ("print('loaded 3 models')\nprint('score: nan')", "the last line that it printed is 'score: nan'"),
        ("", "the last line that it printed is ''"),
    ],
)
def test_what_goes_wrong_is_said(tmp_path, program, message):
    with pytest.raises(BenchError, match=message):
        checkout(tmp_path, "md_vqa", program)(VIDEO, 30.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    root = tmp_path_factory.mktemp("observed") / "sway"
    made = make_synthetic_dataset(
        root, n_views=3, n_timesteps=6, size=48, freqs=(5.0,), amplitude=0.02, alphas=(5,), n_test=3
    )
    return *made, open_set(root, "sway")


def moving(motion):
    size = rms_motion(motion)
    return size > 0.3 * size.max()


def test_the_true_motion_is_observed(scene):
    gaussians, motion, data = scene
    agrees = agreement(gaussians, motion, data)
    assert (agrees[moving(motion)] > 0.9).mean() > 0.9


def test_a_motion_that_the_pictures_do_not_show_is_not(scene):
    """As of a mirror: the surface moves, what is seen in it does not, or moves otherwise."""
    gaussians, motion, data = scene
    late = with_phasors(motion, displacement=motion.displacement * 1j)  # a quarter of a period
    assert (agreement(gaussians, late, data)[moving(motion)] >= AGREES).mean() < 0.1


def test_errors_of_what_is_not_observed_do_not_count(scene, monkeypatch):
    """Half of what moves is observed, the motion is right there and 40 % too small elsewhere."""
    gaussians, motion, data = scene
    train = load_capture(data.root)
    seen = np.zeros(len(gaussians), bool)
    seen[np.flatnonzero(moving(motion))[::2]] = True
    monkeypatch.setattr("tg4mm.research.bench.measure.agreement", lambda *_: np.where(seen, 1.0, 0.0))
    estimated = with_phasors(
        motion, displacement=motion.displacement * np.where(seen, 1.0, 0.6)[None, :, None]
    )
    subject = Subject(gaussians, estimated, motion, None, AS_CAPTURED, False, None)
    found = observed_figures(subject, data, train)
    weights = blending_weights(gaussians, train) * (rms_motion(motion) > 0.01 * rms_motion(motion).max())
    assert found["observed_share"] == pytest.approx(weights[seen].sum() / weights.sum(), rel=1e-3)
    assert 0.2 < found["observed_share"] < 0.8
    assert found["displacement_error_observed"] < 0.02
    everything = displacement_figures(estimated, motion, blending_weights(gaussians, train))
    assert everything["relative_error"] > 0.1
