"""README's figures and those of docs/results.md are one generated table."""

import json

import pytest

from benchmarks.figures import (
    FILE,
    PAGES,
    bounds_table,
    figures_of,
    filled,
    merged,
    noise_plot,
    rivals_tables,
    split_tables,
    tables,
)
from tg4mm.core.errors import Tg4mmError
from tg4mm.research.bench.means import group_means, line_means


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_prints_the_figures_of_the_file(page):
    text, figures = page.read_text(encoding="utf-8"), json.loads(FILE.read_text(encoding="utf-8"))
    assert "<!-- figures: " in text
    assert filled(text, tables(figures)) == text
    figures["scenes"]["mic"]["displacement_error"] += 0.1  # in every table but that of SSIM
    assert filled(text, tables(figures)) != text


def test_marks_with_nothing_between_are_filled_and_leave_the_next_section():
    a, b, end = "<!-- figures: a -->\n", "<!-- figures: b -->\n", "<!-- end -->\n"
    made = {"a": "| 1 |", "b": "| 2 |"}
    assert filled(f"{a}{end}words\n{b}old\n{end}", made) == f"{a}| 1 |\n{end}words\n{b}| 2 |\n{end}"
    with pytest.raises(Tg4mmError, match="of 2 marks of figures 1 have an end"):
        filled(f"{a}words\n{b}old\n{end}", made)


def test_figures_are_those_of_a_benchmarks_results():
    run = {
        "set": "mic_5Hz_0_005", "row": "modal", "log": {}, "n_gaussians": 9, "mib_on_disk": 1.0,
        "displacement": {"relative_error": 0.04, "static_leak": 0.01, "per_frequency": []},
        "seconds": {"space": 1.0, "motion": 1.0, "total": 2.0},
    }  # fmt: skip
    means = [{"row": row, "alphas": {"20": {"ssim": 0.9}}} for row in ("nothing moves", "modal", "ceiling")]
    found = figures_of({"runs": [run], "line_means": means})
    assert found["scenes"]["mic"]["displacement_error"] == 0.04
    assert found["ssim"]["ceiling"] == {"20": 0.9}


def test_the_other_tables_are_of_results_too():
    run = {
        "set": "mic_5Hz_0_005", "row": "modal", "log": {}, "n_gaussians": 12984, "mib_on_disk": 4.2,
        "displacement": {"relative_error": 0.058, "static_leak": 0.01, "per_frequency": [
            {"amplitude_true": 1.0, "amplitude_ratio": 0.957, "mac": 0.998, "frequency_hz": 5.0}
        ]},
        "seconds": {"space": 19.0, "motion": 16.0, "total": 35.0}, "rows": {}, "ways": ["modal"], "preset": "modal",
    }  # fmt: skip
    scores = {"alphas": {"20": {"ssim": 0.952, "lpips": 0.05, "closure": 0.9}}, "frames_per_s": 158.2}
    rows = ("nothing moves", "modal", "linear-2d", "ceiling")
    lines = [{"set": run["set"], "row": row, **scores} for row in rows]
    groups = {run["set"]: "all"}
    results = {
        "sets": [{"label": run["set"], "width": 256}],
        "runs": [run], "lines": lines, "means": group_means([run], groups), "line_means": line_means(lines, groups)
    }  # fmt: skip
    made = split_tables(results, "dev")
    assert made["dev"]["rows"][1:3] == [["`modal`", "0.90, .9520"], ["`linear-2d`", "0.90, .9520"]]
    assert made["dev_sets"]["rows"][:2] == [["mic 5 Hz", "5.8, .998"], ["mean", "5.8, .998"]]
    rivals = rivals_tables(results)
    assert rivals["rivals"]["header"][2] == "mic 256², 20"
    assert rivals["rivals"]["rows"][1] == ["`modal`", "", ".9520/.0500", ""]
    assert rivals["rivals_errors"]["rows"] == [["mic 256²", "5.8, .998"]]


def test_printed_bounds_become_a_table_and_a_plot():
    text = "| set | error, % | noise, % | bound, % | parts known, % |\n|:--|--:|\n| mic_4_3Hz_0_5px | 4 | 2 | 3 | 1 |\n"
    made = bounds_table(text, "dev")
    assert made["dev_sets"]["rows"] == [["mic 4.3 Hz", "2", "3", "1"]]
    made = made["bounds"]
    assert made["rows"] == [["mic 4.3 Hz, dev", "4", "2", "3", "1"]]
    assert noise_plot(made["rows"], made["header"]).count("parts known") == 1


def test_a_part_of_a_table_leaves_the_rest():
    old = {"a": {"header": ["", "x", "y"], "rows": [["one", "1", "2"], ["two", "3", "4"]]}}
    new = {"a": {"header": ["", "y", "z"], "rows": [["two", "5", "6"], ["three", "", "7"]]}}
    rows = [["one", "1", "2", ""], ["two", "3", "5", "6"], ["three", "", "", "7"]]
    assert merged(old, new) == {"a": {"header": ["", "x", "y", "z"], "rows": rows}}
