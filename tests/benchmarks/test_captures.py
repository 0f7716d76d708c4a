"""benchmarks/captures.py: its sets are ones that the generator makes, and its table says what is there."""

import json

import pytest

from benchmarks.captures import COLUMNS, EFFECTS, KINDS, RULE, cases, finish, row
from dataset_gen.options import parser, request_from


def every(tmp_path):
    return list(cases(tmp_path, ["mic", "chair"], list(KINDS), list(EFFECTS)))


def test_every_case_is_a_set_that_the_generator_takes(tmp_path):
    made = every(tmp_path)
    assert len(made) == 2 * len(KINDS) + len(EFFECTS)
    assert len({case.folder for case in made}) == len(made)
    for case in made:
        (settings,) = request_from(parser().parse_args([case.scene, "--out", "x", *case.options])).sets
        assert settings.effects.any == (case.name.startswith("orbit") and case.name.split()[-1] not in _CLEAN)
    kinds = {
        request_from(parser().parse_args(["mic", "--out", "x", *o])).sets[0].cameras.capture_kind
        for o in KINDS.values()
    }
    assert kinds == {"rig", "tripod", "handheld", "clips"}


_CLEAN = ("none", "sensor", "jpeg")  # what a sensor does is no effect of a record


def test_all_effects_together_hold_each(tmp_path):
    (case,) = cases(tmp_path, [], [], ["all"])
    settings = request_from(parser().parse_args([case.scene, "--out", "x", *case.options])).sets[0]
    effects = settings.effects
    assert min(effects.shake_px, effects.exposure_drift, effects.flicker) > 0
    assert (effects.codec, settings.sensor.name, settings.sensor.jpeg_quality) == ("h264", "phone", None)


def test_rows_have_the_columns_of_the_header(tmp_path):
    case = every(tmp_path)[0]
    width = COLUMNS.count("|")
    assert RULE.count("|") == width
    assert row(case, "no motion found").count("|") == width
    assert "no motion found" in row(case, "no motion found")


def test_a_row_holds_the_figures_of_the_evaluation(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.captures.strongest_hz", lambda run: 3.401)
    monkeypatch.setattr("benchmarks.captures.Run.open", lambda folder: folder)
    case = every(tmp_path)[1]
    case.metrics.parent.mkdir(parents=True)
    at = {"frequency_hz": 3.4, "amplitude_ratio": 0.97, "direction_error_deg": 2.34}
    rows = {"ours": {"ssim": 0.98}, "nothing moves": {"ssim": 0.95}}
    figures = {
        "displacement": {"relative_error": 0.123, "static_leak": 0.045, "per_frequency": [at]},
        "alphas": [{"alpha": 0, "rows": {}}, {"alpha": 20, "rows": rows}],
    }
    case.metrics.write_text(json.dumps(figures))
    (case.folder / "train_s.json").write_text("61.7")
    cells = [cell.strip() for cell in row(case, "").split("|")[1:-1]]
    assert cells == [
        "mic, sweep",
        "12.3 %",
        "4.5 %",
        "0.970",
        "2.3°",
        "3.401",
        "3.400",
        "0.9800",
        "0.9500",
        "62",
    ]
    assert len(cells) == COLUMNS.count("|") - 1
    case.metrics.write_text(json.dumps({"displacement": None, "alphas": []}))
    assert "–" in row(case, "")


def test_a_case_that_is_done_is_left_alone_and_a_failed_one_says_why(tmp_path, monkeypatch):
    case = every(tmp_path)[0]
    assert finish(case, ["--size", "7"], [], []) == "error: --size 7 is not a whole number in 8 … 4096"
    case.metrics.parent.mkdir(parents=True)
    case.metrics.write_text("{}")
    monkeypatch.setattr("benchmarks.captures._run", lambda command: pytest.fail("it ran again"))
    assert finish(case, [], [], []) == ""
