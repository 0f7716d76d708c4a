"""The main table: its numbers are evaluate's, what is finished is not done again, and times are matched by settings."""

import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.research.bench.conftest import MODAL, PAPER
from tests.show.view.browser import browser
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import Magnification
from tg4mm.research.bench import methods
from tg4mm.research.bench.jobs import job_folder, rendered
from tg4mm.research.bench.means import half_width, less, line_means
from tg4mm.research.bench.measure import SEEN
from tg4mm.research.bench.methods.known import External
from tg4mm.research.bench.pages.tables import differences_tables, pivots
from tg4mm.research.bench.request import BenchPlan, Training, same_time_training
from tg4mm.research.bench.scenes import ScenesRequest, run_scenes, same_time_trainings
from tg4mm.research.bench.sets import open_set, truth_at
from tg4mm.research.evaluate.run import evaluate_run
from tg4mm.run import Run
from tg4mm.run.train import parse_settings

REQUEST = ScenesRequest(
    methods=("modal", "paper-tuned"), settings={"modal": MODAL, "paper-tuned": PAPER}, same_time="never"
)


def silent(_):
    """No messages."""


@pytest.fixture(scope="module")
def done(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("scenes") / "out"
    return out, run_scenes([data], out, REQUEST, silent)


def entry(results, name):
    (found,) = [r for r in results["runs"] if r["row"] == name]
    return found


@pytest.mark.parametrize(
    ("row", "way"), [("modal", "modal"), ("paper-tuned", "linear"), ("paper-tuned", "phase")]
)
def test_the_numbers_are_those_of_evaluate(done, data, tmp_path, row, way):
    out, results = done
    run = Run.open(out / "runs" / data.name / row / "run")
    again = evaluate_run(
        run,
        out=tmp_path / "m.json",
        magnified=Magnification.of(1.0, results["sets"][0]["band_hz"], method=way),
    )
    ours = entry(results, row)
    for scored in again["alphas"]:
        found = ours["rows"][str(scored["alpha"])]
        measured = {key: scored[key] for key in SEEN} | {"ssim": scored["rows"]["ours"]["ssim"]}
        assert {key: value for key, value in found[way].items() if value is not None} == measured
        for name in ("nothing moves", "ceiling"):
            assert found[name]["ssim"] == scored["rows"][name]["ssim"]
    assert ours["displacement"] == again["displacement"]
    assert ours["seconds"]["motion"] == run.log()["motion"]["seconds"]


def cells(page, title, *first):
    """The numbers of the line that begins with `first`, in the table under `title`."""
    part = page.split(f"### {title}\n")[1].split("###")[0]
    lines = [[c.strip() for c in x.split("|")[1:-1]] for x in part.splitlines() if x.startswith("|")]
    (found,) = [x[len(first) :] for x in lines if tuple(x[: len(first)]) == first]
    return found


def test_the_page_prints_the_numbers_of_the_json(done, data):
    out, results = done
    page = (out / "results.md").read_text(encoding="utf-8")
    for line in results["lines"]:
        alphas = sorted(line["alphas"], key=float)
        assert cells(page, "SSIM", line["row"]) == [f"{line['alphas'][a]['ssim']:.4f}" for a in alphas]
        assert cells(page, "gain", line["row"]) == [f"{line['alphas'][a]['gain']:.2f}" for a in alphas]
    linear = entry(results, "paper-tuned")["rows"]["20"]["linear"]
    own = cells(page, "Against its own ceiling", data.name, "paper-tuned: linear", "20")
    assert own == [f"{linear[key]:.2f}" for key in SEEN]
    made = results["made"]
    assert all(str(made[key]) in page for key in ("command", "date", "tg4mm", "processor"))
    assert "![SSIM and closure over magnification" in page
    assert (out / "results_1.svg").is_file()
    assert json.loads((out / "results.json").read_text(encoding="utf-8")) == results


def test_what_is_finished_is_not_done_again(done, data, monkeypatch):
    out, results = done

    def forbidden(*_, **__):
        raise AssertionError("done again")

    for name in ("measure.train", "measure.evaluate_run", "jobs.write_png", "jobs.score_pictures"):
        monkeypatch.setattr(f"tg4mm.research.bench.{name}", forbidden)
    again = run_scenes([data], out, REQUEST, silent)
    assert (again["runs"], again["lines"]) == (results["runs"], results["lines"])


def test_other_alphas_are_scored_without_training(done, data, monkeypatch):
    out, results = done
    space = out / "runs" / data.name / "modal" / "run" / "space.safetensors"
    before = space.stat().st_mtime_ns
    plan = BenchPlan(alphas=(5.0,))
    again = run_scenes([data], out, replace(REQUEST, methods=("modal",), plan=plan), silent)
    assert list(entry(again, "modal")["rows"]) == ["0", "5"]
    assert entry(again, "modal")["rows"]["5"] == entry(results, "modal")["rows"]["5"]
    assert space.stat().st_mtime_ns == before


def test_a_band_that_is_set_is_what_every_method_magnifies(data, tmp_path):
    """Where nothing moves in it, a method without training shows the motion as it was, a sixth of the truth's."""
    methods, plan = ("modal", "phase-2d"), BenchPlan(alphas=(5.0,))
    gains = {}
    for band in ("4 6", "8 12"):
        asked = ScenesRequest(methods, {"modal": MODAL | {"motion.band": band}}, plan=plan)
        results = run_scenes([data], tmp_path / band.replace(" ", "_"), asked, silent)
        (line,) = [x for x in results["lines"] if x["row"] == "phase-2d"]
        gains[results["band"]] = line["alphas"]["5"]["gain"]
    assert gains["4 to 6 Hz"] > 0.5
    assert gains["8 to 12 Hz"] == pytest.approx(1 / 6, abs=0.05)


class TestSameTime:
    def test_all_iterations_are_scaled(self):
        training = same_time_training("paper-tuned", {"paper.iterations": "400", "paper.warm_up": "100"}, 1.5)
        config = parse_settings(training.settings, "paper-tuned")["paper"]
        assert (config.warm_up, config.iterations, config.motion_iterations) == (150, 600, 300)

    @pytest.mark.parametrize(
        ("rule", "modal_s", "paper_s", "factor"),
        [
            ("needed", 90.0, 60.0, 1.5),
            ("needed", 60.0, 90.0, None),
            ("always", 60.0, 90.0, 2 / 3),
            ("never", 90.0, 60.0, None),
        ],
    )
    def test_when(self, rule, modal_s, paper_s, factor):
        figures = {"modal": {"seconds": {"total": modal_s}}, "paper-tuned": {"seconds": {"total": paper_s}}}
        found = same_time_trainings(figures, ScenesRequest(same_time=rule))
        expected = [] if factor is None else [same_time_training("paper-tuned", {}, factor)]
        assert found == expected


def test_means_of_a_table_are_of_the_same_sets():
    """What one row lacks in a set it has no mean of; what every row lacks there is the mean of the other sets."""
    values = {
        ("one", "a"): (0.5, 0.7),
        ("two", "a"): (None, None),
        ("one", "b"): (0.3, 0.9),
        ("two", "b"): (0.1, None),
    }
    lines = [
        {"set": name, "row": row, "frames_per_s": None, "alphas": {"5": {"closure": closure, "gain": gain}}}
        for (name, row), (closure, gain) in values.items()
    ]
    a, b = line_means(lines, dict.fromkeys(("one", "two"), "group"))
    assert a["alphas"]["5"] == {"closure": None, "gain": pytest.approx(0.7)}
    assert b["alphas"]["5"] == {"closure": pytest.approx(0.2), "gain": pytest.approx(0.9)}


def test_a_record_stays_until_the_first_new_picture(data, tmp_path):
    """A folder with pictures of two recipes has no record."""
    opened, capture = open_set(data, data.name), truth_at(open_set(data, data.name), 0)
    record, made = tmp_path / "pictures" / "ours" / "x000.json", 0

    def render(*_):
        for i in range(made):
            yield i, np.zeros((capture.height, capture.width, 3), np.float32)
        if made < len(capture):
            raise RunError("it was killed")

    def method(version):
        return SimpleNamespace(recipe=lambda *_: {"version": version}, render=render)

    made = len(capture)
    rendered(method(1), "ours", opened, tmp_path, capture, 0, BenchPlan())
    for first, stays in ((0, True), (1, False)):
        made = first
        with pytest.raises(RunError):
            rendered(method(2), "ours", opened, tmp_path, capture, 0, BenchPlan())
        assert record.exists() == stays


def test_a_run_of_another_device_is_refused(done, data):
    """Its seconds would be taken for the other's."""
    method = methods.Trained(Training("modal", "modal", MODAL))
    opened = open_set(data, data.name)
    with pytest.raises(RunError, match="was trained with --device cpu, not cuda"):
        method.fit(opened, job_folder(done[0], opened, method), BenchPlan(device="cuda"))


@pytest.mark.parametrize(("n_scenes", "between"), [(2, 1.0), (3, 0.3), (8, 1.0)])
def test_nineteen_of_twenty_intervals_hold_the_mean(n_scenes, between):
    """Three seeds a scene; a scene differs from the mean by `between`, a seed from its scene by 1, both normal."""
    rng = np.random.default_rng(7)
    scenes = [f"scene {i}" for i in range(n_scenes) for _ in range(3)]
    held = 0
    for _ in range(800):
        values = np.repeat(between * rng.normal(size=n_scenes), 3) + rng.normal(size=3 * n_scenes)
        held += abs(values.mean()) <= half_width(values, scenes)
    assert held / 800 > 0.935


def test_seeds_of_one_scene_are_drawn_by_themselves_and_one_value_tells_nothing():
    assert half_width([0.9], ["mic"]) is None
    assert half_width([0.5, 0.5, 0.5], ["mic"] * 3) == 0
    # t at two degrees of freedom times the standard error
    values = [1.0, 2.0, 4.0]
    expected = 4.303 * np.std(values, ddof=1) / np.sqrt(3)
    assert half_width(values, ["mic"] * 3) == pytest.approx(expected, rel=0.03)


def test_tables_have_the_interval_of_a_mean_and_of_the_difference_on_each_set():
    sets = {"mic_s0": "mic", "mic_s1": "mic", "ship_s0": "ship", "ship_s1": "ship"}
    scores = {"modal": (0.9, 0.91, 0.8, 0.82), "linear-2d": (0.89, 0.9, 0.79, 0.81)}
    lines = [
        {"set": label, "row": row, "alphas": {"20": {"ssim": value}}, "frames_per_s": None}
        for row, values in scores.items()
        for label, value in zip(sets, values, strict=True)
    ]
    groups = dict.fromkeys(sets, "all")
    (table,) = pivots(line_means(lines, groups, sets), "all")
    half = half_width(scores["modal"], list(sets.values()))
    assert table.rows[0] == ["modal", f"0.8575 ± {half:.4f}"]
    results = {"differences": line_means(less(lines, "modal"), groups, sets), "against": "modal"}
    (table,) = differences_tables(results, "all")
    assert table.rows == [["linear-2d", "-0.0100 ± 0.0000"]]


@pytest.fixture(scope="module")
def made(data, tmp_path_factory):
    """A benchmark of methods without training."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(data, folder / "theirs" / data.name)
    request = ScenesRequest(("linear-2d", "phase-2d"), external=(External("theirs", folder / "theirs"),))
    run_scenes([data], folder / "out", request, lambda text: None)
    return folder / "out"


def test_the_page_loads_nothing(made):
    page = (made / "results.html").read_text(encoding="utf-8")
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)[^\"]*\"", page)
    assert page.count("<video") == 4  # the ground truth and three methods
    assert page.count('class="compare"') == 1


def test_in_a_browser(made):
    with browser() as opened:
        page = opened.new_page()
        errors: list[Any] = []
        page.on("pageerror", lambda error: errors.append(error))
        page.goto((made / "results.html").as_uri())
        table = "figure.table:has(figcaption:has-text('Every set'))"
        column = f"{table} tbody td:nth-child(4)"
        shown = [float(x) for x in page.locator(column).all_inner_texts()]
        page.click(f"{table} th:nth-child(4)")
        assert [float(x) for x in page.locator(column).all_inner_texts()] == sorted(shown)
        page.click(f"{table} th:nth-child(4)")
        assert [float(x) for x in page.locator(column).all_inner_texts()] == sorted(shown, reverse=True)
        left = page.locator('.compare img[data-side="left"]')
        page.locator(".compare [data-edge]").fill("20")
        assert "80%" in left.evaluate("e => e.style.clipPath")
        at = (
            "e => parseFloat(getComputedStyle(e.parentElement, '::after').left) / e.parentElement.clientWidth"
        )
        assert left.evaluate(at) == pytest.approx(0.2, abs=0.01)
        before = left.get_attribute("src")
        page.locator('.compare select[data-pick="left"]').select_option(label="linear-2d")
        assert left.get_attribute("src") != before
        assert not errors
