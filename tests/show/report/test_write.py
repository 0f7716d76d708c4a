"""Whole reports: of a full dataset, of the least there can be, of a scene with a hostile name."""

import json
import shutil

import numpy as np
import pytest

from tests.helpers.runs import made_run
from tests.helpers.synthetic import exact_run, make_synthetic_dataset, moving_run
from tests.show.report.page_checks import check, read_page, words
from tg4mm.capture import load_capture
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import AS_CAPTURED
from tg4mm.core.pictures.decode import write_png
from tg4mm.research.evaluate.run import evaluate_run
from tg4mm.run import Run
from tg4mm.show.measure import measure
from tg4mm.show.measure.tables import rows_of
from tg4mm.show.report import ReportOptions, write_report
from tg4mm.show.report.sources import gather_view, load_model
from tg4mm.show.result import Length, result_of
from tg4mm.show.result.model import with_deviation
from tg4mm.show.result.reading import reading_of


def report(made, folder, **options):
    return write_report(made, folder / "report.html", ReportOptions(**options)).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def full(run, metrics, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    orbit = folder / "orbit"
    orbit.mkdir()
    (orbit / "orbit.mp4").write_bytes(b"not really a film")
    write_png(orbit / "r_000.png", np.zeros((4, 4, 3)))
    options = {"alpha": 20, "orbit": orbit, "metrics": metrics}
    first, again = (report(run, folder / name, **options) for name in ("deep", "again"))
    assert first == again  # the same run gives the same report
    return first


def test_a_full_report_is_well_formed_and_loads_nothing(full):
    check(full)


def test_its_figures_are_those_of_the_result(full, run):
    said, result = words(full), result_of(run)
    assert result.vibrations
    for v in result.vibrations:
        assert with_deviation(Length(v.hz, v.deviation_hz)) in said
        assert f"{with_deviation(v.amplitude.times(1000 * result.unit_scale_m))} mm" in said
        assert f"{with_deviation(v.pixels)} px" in said
        assert f"{v.band[0]:g} to {v.band[1]:g}" in said
    for line in result.cannot:
        assert line[1:] in said
    assert result.next_command.removeprefix("tg4mm ") in said


def test_its_sensors_are_those_of_measure(full, run):
    said, found = words(full), measure(run)
    for result in found.sensors:
        assert f"Sensor “{result.name}”, {int((result.body.weights > 0).sum()):,} Gaussians" in said
        for cell in (cell for row in rows_of(found, result) for cell in row):
            assert cell in said
    for note in found.notes:
        assert note[1:] in said


def test_scores_are_printed_beside_both_anchors(full, metrics):
    said = words(full)
    for entry in metrics["alphas"]:
        for name in ("nothing moves", "ours", "ceiling"):
            assert f"{entry['rows'][name]['ssim']:.4f}" in said
    still = metrics["alphas"][-1]["rows"]["nothing moves"]["ssim"]
    assert f"A model in which nothing moves scores SSIM {still:.4f} at α = 20" in said
    assert "LPIPS was not measured: no weights given" in said


def test_a_dataset_without_truth_has_a_page_without_a_word_of_it(bare_run, tmp_path):
    text = report(bare_run, tmp_path)
    check(text)
    said = words(text)
    for absent in ("Ground truth", "How true it is", "SSIM", "Displacement error", "Not measured", " mm"):
        assert absent not in said.replace("tg4mm", "")
    assert text.count("<video ") == 2  # input and ours
    assert "The sensors" in said
    assert "scene units" in said


def test_a_capture_of_one_timestep_has_a_report(tmp_path):
    made, _ = exact_run(tmp_path, n_views=3, n_timesteps=1, size=32)
    text = report(made, tmp_path, metrics={})
    check(text)
    assert "has no motion to magnify" in words(text)
    assert "<video " not in text


def test_a_run_without_vibrations_has_a_report(bare_run, tmp_path):
    found = bare_run.load_motion()
    bare_run.save_motion(found.selected(found.freqs_hz < 0), {})
    text = report(bare_run, tmp_path)
    check(text)
    assert "No vibration stands out of the noise" in words(text)


def test_a_camera_that_moves_is_shown_from_its_own_poses(tmp_path):
    n = 10
    gaussians, motion = make_synthetic_dataset(tmp_path / "d", n_views=1, n_timesteps=n, size=32, n_test=0)
    for t in range(n):
        path = tmp_path / "d" / f"{t:03d}" / "transforms_train.json"
        transforms = json.loads(path.read_text())
        transforms["frames"][0]["transform_matrix"][0][3] += 0.05 * t
        path.write_text(json.dumps(transforms))
    made = made_run(tmp_path / "run", tmp_path / "d", gaussians, motion)
    text = report(made, tmp_path, alpha=10, metrics={})
    check(text)
    said = words(text)
    assert "ours is rendered from the same poses" in said
    assert "both slices are of the model" in said
    assert text.count("<video ") == 2
    capture = load_capture(tmp_path / "d")
    view = gather_view(made, capture, load_model(reading_of(made), capture, AS_CAPTURED), AS_CAPTURED)
    assert len(view.ours) == len(view.input) == n
    apart, *fixed = (np.abs(v[0].astype(int) - v[-1]).mean() for v in (view.ours, *view.fixed))
    assert apart > 1  # the poses differ
    assert max(fixed) < apart  # from one pose only vibration is left


def test_hostile_names_stay_text(tmp_path):
    evil = "<script>alert(1)</script>'\"><img src=x onerror=alert(2)>"
    gaussians, motion = make_synthetic_dataset(tmp_path / "d", n_views=2, n_timesteps=8, size=32, n_test=0)
    scene = json.loads((tmp_path / "d" / "scene.json").read_text())
    (tmp_path / "d" / "scene.json").write_text(json.dumps({**scene, "scene": evil}))
    name = "<b onclick=alert(3)>&"
    for t in range(8):
        folder = tmp_path / "d" / f"{t:03d}"
        for i in range(2):
            (folder / "train" / f"r_{i:03d}.png").rename(folder / "train" / f"{name}{i}.png")
        path = folder / "transforms_train.json"
        path.write_text(path.read_text().replace("./train/r_00", f"./train/{name}"))
    made = Run.create(tmp_path / "run", tmp_path / "d", "modal", {})
    made.save_space(gaussians, {})
    made.save_motion(motion, {"notes": [evil]})
    hostile = {"alphas": [], "metrics": [], "absent": {evil: evil}, "notes": [evil]}
    text = report(made, tmp_path, metrics={"format": "tg4mm-metrics"} | hostile)
    check(text)
    reader = read_page(text)
    assert not reader.handlers
    assert reader.tags.count("script") == 1 + text.count('<script type="application/json" class="curves">')
    assert evil in "".join(reader.text)
    assert name in "".join(reader.text)  # the camera's


def test_bad_requests_leave_no_report(run, metrics, tmp_path):
    for options, message in (
        ({"band": (6.4, 7.0), "metrics": metrics}, "holds none of the model's frequencies"),
        ({"metrics": {"format": "other"}}, "'other'"),
    ):
        with pytest.raises(RunError, match=message):
            report(run, tmp_path / "out", **options)
        assert not (tmp_path / "out").exists()


def test_part_of_the_ground_truth_is_scored_and_said(tmp_path):
    """Every third timestep at one α, without the exact motion."""
    made = moving_run(tmp_path, n_views=3, n_timesteps=6, size=32, freqs=(5.0,), alphas=(5,), n_test=1)
    (made.dataset / "truth" / "motion.npz").unlink()
    for timestep in (made.dataset / "magnified" / "x005").iterdir():
        if int(timestep.name) % 3:
            shutil.rmtree(timestep)
    said = words(report(made, tmp_path, alpha=5.0, evaluate=evaluate_run))
    assert "The ground truth at α = 5 holds 2 of 6 timesteps from this camera" in said
    assert "needs the exact motion (truth/motion.npz)" in said
    assert "α = 5, part of it: 4 of 6 timesteps" in said
