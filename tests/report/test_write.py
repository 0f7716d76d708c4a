"""Whole reports: of a full dataset, of the least there can be, of a scene with a hostile name."""

import base64
import json
import re
import shutil
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.report.page_checks import outside_loads, read_page
from tests.synthetic import make_synthetic_dataset
from tg4mm.errors import CaptureError, RunError
from tg4mm.render.frames import write_png
from tg4mm.report import ReportOptions, write_report
from tg4mm.runs import Run


def words(text: str) -> str:
    return " ".join(" ".join(read_page(text).text).split())


def check(text: str) -> None:
    reader = read_page(text)
    assert not reader.errors
    assert not reader.open
    assert not outside_loads(text)
    for svg in re.findall(r"<svg.*?</svg>", text, re.S):
        ElementTree.fromstring(svg)


@pytest.fixture(scope="module")
def full(run, metrics, tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("page")
    orbit = folder / "orbit"
    orbit.mkdir()
    (orbit / "orbit.mp4").write_bytes(b"not really a film")
    write_png(orbit / "r_000.png", np.zeros((4, 4, 3)))
    path = write_report(
        run, run.dataset, metrics, folder / "deep" / "report.html", ReportOptions(orbit=orbit)
    )
    return path.read_text(encoding="utf-8")


def test_a_full_report_is_well_formed_and_loads_nothing(full):
    check(full)


def test_it_shows_the_true_amplitude_frequency_and_direction(full):
    said = words(full)
    # The ball: 0.01 scene units of 0.1 m along (0.8, 0, 0.6), at 5 Hz.
    assert "The strongest motion found is 1 mm at 5 Hz" in said
    assert "0.80, 0.00, 0.60" in said
    assert "shown here 21 times larger" in said
    assert "Training time 1 min 31 s" in said
    assert "defines displacement error, ceiling" in said


def test_scores_are_printed_beside_both_anchors(full, metrics):
    said = words(full)
    for entry in metrics["alphas"]:
        for name in ("nothing moves", "ours", "ceiling"):
            assert f"{entry['rows'][name]['ssim']:.4f}" in said
    still = metrics["alphas"][-1]["rows"]["nothing moves"]["ssim"]
    assert f"A model in which nothing moves scores SSIM {still:.4f} at α = 20" in said
    assert "LPIPS was not measured: no weights given" in said


def test_it_shows_how_sure_the_run_is_if_the_run_says_it(full, bare_run, tmp_path):
    said = words(full)
    assert "Uncertainty is one standard deviation" in said
    # The motion is exact: all of it is within what the run says, 0.0002 units of 0.1 m.
    assert "The run itself says it is off by 0.0002 scene units (20 µm) rms; 100 % of what is seen" in said
    path = write_report(bare_run, bare_run.dataset, {}, tmp_path / "bare.html")
    assert "Uncertainty" not in words(path.read_text(encoding="utf-8"))


def test_videos_are_embedded_and_start_by_themselves(full):
    sources = re.findall(
        r'<video src="data:video/mp4;base64,([^"]+)"[^>]* autoplay loop muted playsinline>', full
    )
    assert len(sources) == 4  # input, ours, truth, orbit
    for source in sources[:3]:
        assert base64.b64decode(source)[4:8] == b"ftyp"
    assert base64.b64decode(sources[3]) == b"not really a film"


def test_every_section_and_command_is_there(full, run):
    said = words(full)
    for title in ("The capture", "The motion", "How true it is", "What it cost", "What to do next"):
        assert title in said
    for what in (
        "Space-time slices",
        "Difference maps",
        "Spectrum of the displacement",
        "Amplitude at 5 Hz",
        "Phase at 5 Hz",
    ):
        assert what in said
    assert f"tg4mm render {run.path} --alpha 50" in said
    assert f"tg4mm export {run.path} --format ply" in said


def test_a_dataset_without_truth_test_split_or_scale_says_so(bare_run, tmp_path):
    text = write_report(bare_run, bare_run.dataset, {}, tmp_path / "r.html").read_text(encoding="utf-8")
    check(text)
    said = words(text)
    assert "no test split" in said
    assert "scale unknown" in said
    assert "has not been evaluated" in said
    assert " mm" not in said.replace("tg4mm", "")
    assert text.count("<video ") == 2  # input and ours


def test_metrics_with_everything_absent_are_shown_as_such(bare_run, tmp_path):
    from tg4mm.evaluate import evaluate_run

    metrics = evaluate_run(bare_run)
    said = words(
        write_report(bare_run, bare_run.dataset, metrics, tmp_path / "r.html").read_text(encoding="utf-8")
    )
    assert "no scores" in said
    assert "Not measured." in said
    assert "displacement error is not known" in said


def test_a_capture_of_one_timestep_has_a_report(tmp_path):
    gaussians, _ = make_synthetic_dataset(tmp_path / "one", n_views=3, n_timesteps=1, size=32)
    made = Run.create(tmp_path / "run", tmp_path / "one", "modal", {})
    made.save_space(gaussians, {"seconds": 3.0})
    text = write_report(made, made.dataset, {}, tmp_path / "r.html").read_text(encoding="utf-8")
    check(text)
    assert "has no motion to magnify" in words(text)
    assert "<video " not in text


def test_a_single_nerf_synthetic_folder_has_a_report(tmp_path):
    gaussians, _ = make_synthetic_dataset(tmp_path / "one", n_views=2, n_timesteps=1, size=32)
    made = Run.create(tmp_path / "run", tmp_path / "one" / "000", "modal", {})
    made.save_space(gaussians, {})
    text = write_report(made, made.dataset, {}, tmp_path / "r.html").read_text(encoding="utf-8")
    check(text)
    assert "2 training cameras, one timestep: 2 images of 32 × 32 pixels" in words(text)


def test_a_camera_that_moves_all_the_time_has_no_input_video(bare_run, tmp_path):
    for t in range(6):
        path = bare_run.dataset / f"{t:03d}" / "transforms_train.json"
        transforms = json.loads(path.read_text())
        for frame in transforms["frames"]:
            frame["transform_matrix"][0][3] += 0.01 * t
        path.write_text(json.dumps(transforms))
    text = write_report(bare_run, bare_run.dataset, {}, tmp_path / "r.html").read_text(encoding="utf-8")
    check(text)
    assert "No camera stands still: this one took 1 of the 6 timesteps." in words(text)
    assert text.count("<video ") == 1


def test_a_motion_of_nothing_has_a_report(run, metrics, tmp_path):
    made = Run.create(tmp_path / "run", run.dataset, "modal", {})
    motion = run.load_motion()
    made.save_space(run.load_space(), {})
    made.save_motion(replace(motion, displacement=np.zeros_like(motion.displacement)), {})
    check(write_report(made, made.dataset, metrics, tmp_path / "r.html").read_text(encoding="utf-8"))


def test_a_hostile_scene_name_stays_text(run, metrics, tmp_path):
    evil = "<script>alert(1)</script>'\"><img src=http://x/ onerror=alert(2)>"
    shutil.copytree(run.dataset, tmp_path / "data")
    scene = json.loads((tmp_path / "data" / "scene.json").read_text())
    (tmp_path / "data" / "scene.json").write_text(json.dumps({**scene, "scene": evil}))
    hostile = {**metrics, "absent": {evil: evil}, "notes": [evil]}
    text = write_report(run, tmp_path / "data", hostile, tmp_path / "r.html").read_text(encoding="utf-8")
    check(text)
    reader = read_page(text)
    assert not reader.handlers
    assert reader.tags.count("script") == 1
    assert evil in "".join(reader.text)


def test_the_same_run_gives_the_same_report(run, metrics, tmp_path):
    a, b = (
        write_report(run, run.dataset, metrics, tmp_path / name).read_bytes() for name in ("a.html", "b.html")
    )
    assert a == b


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (ReportOptions(band=(4.0, 40.0)), CaptureError, "half the frame rate"),
        (ReportOptions(band=(8.0, 9.0)), RunError, "holds none of the model's frequencies"),
        (ReportOptions(alpha=float("nan")), RunError, "--alpha nan"),
    ],
)
def test_bad_requests_leave_no_report(run, metrics, tmp_path, options, error, message):
    with pytest.raises(error, match=message):
        write_report(run, run.dataset, metrics, tmp_path / "r.html", options)
    assert not (tmp_path / "r.html").exists()


def test_metrics_of_another_kind_are_refused(run, tmp_path):
    with pytest.raises(RunError, match="'other'"):
        write_report(run, run.dataset, {"format": "other"}, tmp_path / "r.html")
