"""Evaluation of whole runs on a small dataset whose exact model is known."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.runs import made_run
from tests.helpers.synthetic import make_synthetic_dataset, with_phasors
from tg4mm.capture import load_capture
from tg4mm.core.errors import CaptureError, RunError
from tg4mm.core.magnification import Magnification
from tg4mm.core.metrics import psnr
from tg4mm.research.evaluate import EvaluationError
from tg4mm.research.evaluate.run import evaluate_run, format_table

STATIC, OURS, CEILING = "nothing moves", "ours", "ceiling"
EXTRAS = {"n_views": 3, "n_timesteps": 10, "size": 40, "n_test": 2, "alphas": (5, 20)}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    root = tmp_path_factory.mktemp("scene") / "posts_3Hz_0_02"
    return root, *make_synthetic_dataset(root, **EXTRAS)


@pytest.fixture
def half(scene, tmp_path):
    """A run that found half of the amplitude, in the right place and phase."""
    root, gaussians, motion = scene
    return made_run(
        tmp_path / "run", root, gaussians, with_phasors(motion, displacement=0.5 * motion.displacement)
    )


def rows_of(metrics, alpha):
    return next(e["rows"] for e in metrics["alphas"] if e["alpha"] == alpha)


def test_the_exact_motion_reaches_the_ceiling_and_the_ceiling_the_ground_truth(scene, tmp_path):
    root, gaussians, motion = scene
    metrics = evaluate_run(made_run(tmp_path / "run", root, gaussians, motion))
    assert [e["alpha"] for e in metrics["alphas"]] == [0, 5, 20]
    assert [e["n_images"] for e in metrics["alphas"]] == [20, 20, 20]
    for alpha in (0, 5, 20):
        rows = rows_of(metrics, alpha)
        assert rows[CEILING]["psnr_db"] > 45  # 8-bit files allow no more than about 59
        assert rows[CEILING]["ssim"] > 0.998
        assert rows[OURS]["psnr_db"] == pytest.approx(rows[CEILING]["psnr_db"], abs=0.05)
    assert metrics["displacement"]["relative_error"] < 1e-3
    assert metrics["displacement"]["static_leak"] < 1e-3
    assert rows_of(metrics, 20)[STATIC]["psnr_db"] < rows_of(metrics, 20)[CEILING]["psnr_db"] - 10
    assert rows_of(metrics, 20)[STATIC]["flip"] > 2 * rows_of(metrics, 20)[CEILING]["flip"]


def test_half_the_amplitude_is_half_an_error_and_a_gap_that_grows(half):
    metrics = evaluate_run(half)
    assert metrics["displacement"]["relative_error"] == pytest.approx(0.5, abs=1e-3)
    error = metrics["displacement"]["relative_error"]
    assert metrics["displacement_error"] == {STATIC: 1.0, OURS: error, CEILING: 0.0}
    row = metrics["displacement"]["per_frequency"][0]
    assert row["frequency_hz"] == 3.0
    assert row["amplitude_ratio"] == pytest.approx(0.5, abs=1e-3)
    assert row["direction_error_deg"] < 0.1
    assert row["amplitude_true_mm"] == pytest.approx(100 * row["amplitude_true"])  # 0.1 m a unit
    gaps = {e["alpha"]: e["gap_to_ceiling"] for e in metrics["alphas"]}
    for key in ("psnr_db", "ssim", "flip"):
        assert 0 < gaps[5][key] < gaps[20][key]
        between = rows_of(metrics, 20)
        low, high = sorted((between[STATIC][key], between[CEILING][key]))
        assert low < between[OURS][key] < high
    assert gaps[20]["lpips"] is None
    assert gaps[20]["psnr_db"] == pytest.approx(between[CEILING]["psnr_db"] - between[OURS]["psnr_db"])


def test_caching_changes_no_number_and_saves_work(half, monkeypatch):
    calls = []
    monkeypatch.setattr("tg4mm.research.evaluate.run.psnr", lambda a, b: calls.append(1) or psnr(a, b))
    cached = evaluate_run(half, out=half.path / "cached.json")
    n_cached = len(calls)
    plain = evaluate_run(half, out=half.path / "plain.json", use_cache=False)
    n_plain = len(calls) - n_cached
    assert n_plain == 3 * 3 * 20
    # A sine of 3 Hz at 30 Hz has 5 poses, whatever the number of timesteps: the rest pose is shared.
    assert n_cached < 0.6 * n_plain
    for a, b in zip(cached["alphas"], plain["alphas"], strict=True):
        for name, row in a["rows"].items():
            assert row["lpips"] is b["rows"][name]["lpips"] is None
            for key in ("psnr_db", "ssim", "flip"):
                assert row[key] == pytest.approx(b["rows"][name][key], rel=1e-5), (name, key)
    assert cached["displacement"] == plain["displacement"]


def test_the_file_is_what_is_returned_and_strict_json(half):
    metrics = evaluate_run(half, alphas=[5])

    def refuse(text):
        raise AssertionError(text)

    assert json.loads((half.path / "metrics.json").read_text(), parse_constant=refuse) == metrics
    assert (metrics["format"], metrics["version"]) == ("tg4mm-metrics", 1)
    assert metrics["metrics"] == ["psnr_db", "ssim", "flip"]
    assert [e["alpha"] for e in metrics["alphas"]] == [0, 5]
    assert sorted(p.name for p in half.path.iterdir() if p.name.startswith(".")) == []


def test_without_its_package_flip_is_said_to_be_absent(half, monkeypatch):
    monkeypatch.setattr("tg4mm.research.evaluate.run.has_flip", lambda: False)
    metrics = evaluate_run(half, alphas=[0], out=half.path / "other.json")
    assert metrics["metrics"] == ["psnr_db", "ssim"]
    assert metrics["absent"]["FLIP"].endswith('pip install "tg4mm[flip]"')
    with pytest.raises(EvaluationError, match="metric flip: needs flip_evaluator"):
        evaluate_run(half, metrics=["flip"])


def test_what_is_there_of_the_ground_truth_is_scored(scene, tmp_path):
    root, gaussians, motion = scene
    part = tmp_path / "part"
    shutil.copytree(root, part, ignore=shutil.ignore_patterns("truth"))
    first, *_, last = sorted((part / "magnified" / "x005").iterdir())
    shutil.rmtree(first)
    shutil.rmtree(last)
    metrics = evaluate_run(made_run(tmp_path / "run", part, gaussians, motion), alphas=[5])
    count = load_capture(part).n_timesteps
    assert metrics["absent"]["α = 5, part of it"] == f"2 of {count} timesteps"
    assert metrics["alphas"][-1]["n_images"] == len(load_capture(part, magnification=5))


def test_what_is_absent_is_said(scene, tmp_path):
    root, gaussians, motion = scene
    bare = tmp_path / "bare"
    gone = shutil.ignore_patterns("truth", "magnified", "test", "transforms_test.json")
    shutil.copytree(root, bare, ignore=gone)
    metrics = evaluate_run(made_run(tmp_path / "run", bare, gaussians, motion), alphas=[5])
    assert metrics["alphas"] == []
    assert metrics["displacement"] is None
    assert set(metrics["absent"]) == {"LPIPS", "α = 0", "α = 5", "ceiling"}
    assert "no weights given" in metrics["absent"]["LPIPS"]
    text = format_table(metrics)
    assert "No images to score." in text
    for what in metrics["absent"]:
        assert f"Not measured: {what}: " in text


def test_a_capture_of_one_timestep_is_scored_at_rest(scene, tmp_path):
    root, gaussians, _ = scene
    metrics = evaluate_run(made_run(tmp_path / "run", root / "000", gaussians, None))
    assert list(rows_of(metrics, 0)) == [STATIC]
    assert rows_of(metrics, 0)[STATIC]["psnr_db"] > 45
    assert "ours" in metrics["absent"]
    assert metrics["alphas"][0]["gap_to_ceiling"] is None
    assert "nothing moves" in format_table(metrics)


def test_what_is_there_but_broken_is_an_error(scene, tmp_path):
    root, gaussians, motion = scene
    copy = tmp_path / "copy"
    shutil.copytree(root, copy)
    run = made_run(tmp_path / "run", copy, gaussians, motion)
    (copy / "003" / "transforms_test.json").write_text("{")
    with pytest.raises(CaptureError, match=r"003/transforms_test\.json"):
        evaluate_run(run)
    (copy / "truth" / "motion.npz").write_bytes(b"PK")
    with pytest.raises(CaptureError, match=r"motion\.npz is damaged"):
        evaluate_run(run)


def test_a_foreign_file_is_not_overwritten_by_figures(half):
    for name in ("space.safetensors", "config.json"):
        before = (half.path / name).read_bytes()
        with pytest.raises(EvaluationError, match=rf"--out .*{name}: exists, and is no tg4mm-metrics"):
            evaluate_run(half, out=half.path / name)
        assert (half.path / name).read_bytes() == before
    with pytest.raises(EvaluationError, match=r"--out /proc/m\.json: cannot be written"):
        evaluate_run(half, out="/proc/m.json")


def test_unusable_requests_are_refused(half, scene, tmp_path):
    for error, said, request in (
        (EvaluationError, "-3", {"alphas": [-3]}),
        (CaptureError, "half the frame rate", {"magnified": Magnification.of(1.0, (4, 40))}),
        (EvaluationError, r"nowhere\.pth does not exist", {"lpips_weights": tmp_path / "nowhere.pth"}),
        (EvaluationError, "is a folder", {"out": tmp_path}),
    ):
        with pytest.raises(error, match=said):
            evaluate_run(half, **request)
    root, gaussians, motion = scene
    other = made_run(tmp_path / "other" / "run", root, gaussians, replace(motion, n_timesteps=12))
    with pytest.raises(RunError, match=r"trained on 12 timesteps at 30 Hz, but .* holds 10 at 30 Hz"):
        evaluate_run(other)
    assert not (other.path / "metrics.json").exists()


def test_a_band_is_judged_by_itself_and_motion_outside_it_is_noted(tmp_path):
    root = tmp_path / "two"
    gaussians, motion = make_synthetic_dataset(root, **EXTRAS | {"freqs": (3.0, 6.0), "alphas": (20,)})
    wrong = motion.displacement.copy()
    wrong[1] *= 0.5  # what is outside the band is off
    run = made_run(tmp_path / "run", root, gaussians, with_phasors(motion, displacement=wrong))
    metrics = evaluate_run(run, magnified=Magnification.of(1.0, (2, 4)))
    assert metrics["band_hz"] == [2.0, 4.0]
    assert metrics["displacement"]["in_band"]["relative_error"] < 1e-3
    assert metrics["displacement"]["relative_error"] > 0.1
    assert metrics["notes"] == ["The ground truth also magnifies motion at 6 Hz, outside the band 2 to 4 Hz."]
    everything = evaluate_run(run)
    assert everything["notes"] == []
    assert rows_of(metrics, 20)[CEILING] == rows_of(everything, 20)[CEILING]
    assert rows_of(metrics, 20)[OURS]["psnr_db"] < rows_of(everything, 20)[OURS]["psnr_db"] - 0.5


def test_motion_that_the_ground_truth_does_not_magnify_is_noted(tmp_path):
    root = tmp_path / "two"
    gaussians, motion = make_synthetic_dataset(root, **EXTRAS | {"freqs": (3.0, 6.0), "alphas": (20,)})
    file = root / "truth" / "motion.npz"
    with np.load(file) as arrays:
        changed = dict(arrays) | {"magnified": np.array([True, False])}
    np.savez(file, **changed)
    run = made_run(tmp_path / "run", root, gaussians, motion)
    note = "The ground truth does not magnify motion at 6 Hz, "
    assert evaluate_run(run, alphas=[0])["notes"] == [note + "without a band, ours does."]
    for high, notes in ((8, [note + "which lies inside the band."]), (4, [])):
        assert evaluate_run(run, alphas=[0], magnified=Magnification.of(1.0, (2, high)))["notes"] == notes
