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
    over_alpha,
    rivals_tables,
    split_tables,
    tables,
    with_mean,
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
    rows = {"nothing moves": 0.852, "modal": 0.942, "linear-2d": 0.942, "ceiling": 0.952}
    lines = [
        {
            "set": run["set"],
            "row": row,
            "alphas": {"20": {"ssim": ssim, "lpips": 0.05}},
            "frames_per_s": 158.2,
        }
        for row, ssim in rows.items()
    ]
    groups = {run["set"]: "all"}
    results = {
        "sets": [{"label": run["set"], "width": 256}],
        "runs": [run], "lines": lines, "means": group_means([run], groups), "line_means": line_means(lines, groups)
    }  # fmt: skip
    made = split_tables(results, "dev")
    assert made["dev"]["rows"][1:3] == [["`modal`", "0.90, .9420"], ["`linear-2d`", "0.90, .9420"]]
    assert made["dev_sets"]["rows"][:2] == [["mic 5 Hz", "5.8, .998"], ["mean", "5.8, .998"]]
    rivals = rivals_tables(results)
    assert rivals["rivals"]["header"][2] == "mic 256², 20"
    assert rivals["rivals"]["rows"][1] == ["`modal`", "", ".9420/.0500", ""]
    assert rivals["rivals_errors"]["rows"] == [["mic 256²", "5.8, .998"]]


def test_printed_bounds_become_a_table_and_a_plot():
    text = "| set | error, % | noise, % | bound, % | parts known, % |\n|:--|--:|\n| mic_4_3Hz_0_5px | 4 | 2 | 3 | 1 |\n"
    made = bounds_table(text, "dev")
    assert made["dev_sets"]["rows"] == [["mic 4.3 Hz", "2", "3", "1"]]
    made = made["bounds"]
    assert made["rows"] == [["mic 4.3 Hz, dev", "4", "2", "3", "1"]]
    assert noise_plot(made["rows"], made["header"]).count("parts known") == 1


def test_means_are_of_all_sets_of_a_table():
    header = ["SSIM/LPIPS at α", *(f"{name}, {a}" for name in ("mic", "lego 256²") for a in (5, 20))]
    rows = [
        ["nothing moves", ".9000/.1", ".8000/.1", ".7000", ".6000"],
        ["`modal`", ".9500/.1", ".8800/.1", ".7800", ".7800"],
        ["`3dmm`", ".9400/.1", ".8500/.1", "", ""],
        ["ceiling", "1.0000/.1", ".9000/.1", ".8000", ".8000"],
    ]
    made = over_alpha({"header": header, "rows": rows})
    assert made["header"] == ["closure, SSIM", "α = 5", "α = 20"]
    closures = [cell.partition(" ±")[0] for cell in made["rows"][1][1:]]
    assert closures == ["0.65", "0.85"]  # of .5 and .8, of .8 and .9
    assert made["rows"][2] == ["`3dmm`, 1 of 2 sets", "0.40, .9400", "0.50, .8500"]
    rows = with_mean([["mic", "8.2, .993", ""], ["lego", "28.2, .929", "34.0, .9"], ["mean", "99, 1", ""]])
    assert [cell.partition(" ±")[0] for cell in rows[-1]] == ["mean", "18.2", "34.0, .900"]


def test_a_part_of_a_table_leaves_the_rest():
    old = {"a": {"header": ["", "x", "y"], "rows": [["one", "1", "2"], ["two", "3", "4"]]}}
    new = {"a": {"header": ["", "y", "z"], "rows": [["two", "5", "6"], ["three", "", "7"]]}}
    rows = [["one", "1", "2", ""], ["two", "3", "5", "6"], ["three", "", "", "7"]]
    assert merged(old, new) == {"a": {"header": ["", "x", "y", "z"], "rows": rows}}
