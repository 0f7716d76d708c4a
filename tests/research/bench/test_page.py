"""The HTML page stands alone and works in a browser; tables, curves and LaTeX hold what they were given."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.helpers.curves import points_of
from tests.show.view.browser import browser
from tg4mm.research.bench.ablation.page import picture
from tg4mm.research.bench.methods.known import External
from tg4mm.research.bench.pages.plots import curves
from tg4mm.research.bench.pages.shown import write_sheet
from tg4mm.research.bench.scenes import ScenesRequest, run_scenes
from tg4mm.research.text import Table, escaped, latex_table, shown, table


@pytest.fixture(scope="module")
def made(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of methods without training."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(data, folder / "theirs" / data.name)
    request = ScenesRequest(("linear-2d", "phase-2d"), external=(External("theirs", folder / "theirs"),))
    run_scenes([data], folder / "out", request, lambda text: None)
    return folder / "out"


def test_the_page_loads_nothing(made: Path) -> None:
    page = (made / "results.html").read_text(encoding="utf-8")
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)[^\"]*\"", page)
    assert page.count("<video") == 4  # the ground truth and three methods
    assert page.count('class="compare"') == 1


def test_in_a_browser(made: Path) -> None:
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


def test_figures_of_a_paper_are_files_too(made: Path, data: Path) -> None:
    """[TG4MM] Fig. 3 and 4: a picture for the ground truth and each of the three methods."""
    sizes = {}
    for kind in ("slices", "differences"):
        with Image.open(made / "figures" / f"{data.name}_{kind}.png") as sheet:
            sizes[kind] = sheet.size
            assert len(np.unique(np.asarray(sheet).reshape(-1, 3), axis=0)) > 10
    assert sizes["slices"] == (720, 4 * (96 + 22) + 4)
    assert sizes["differences"] == (720, 4 * (720 // 5 + 22) + 4)  # five maps side by side, of six timesteps


def test_a_table_longer_than_a_page_goes_on_on_the_next() -> None:
    text = latex_table(Table("x", "A", "B", ["set", "α"], [["mic", str(i)] for i in range(100)]))
    assert text.startswith(r"\begin{longtable}{lr}")
    assert text.count(r"\\") == 102  # the caption too
    assert r"\caption{A. B}" in text


def test_latex_prints_what_the_cells_hold() -> None:
    text = latex_table(Table("x", "A_b", "50 % & more", ["set", "α"], [["mic_5Hz", "0.9"]]), "128×128")
    assert r"\toprule" in text
    assert r"mic\_5Hz & 0.9 \\" in text
    assert r"50 \% \& more" in text
    assert r"128$\times$128" in text
    assert text.count("{") == text.count("}")
    assert escaped("a\\b") == r"a\textbackslash{}b"


def test_table_columns_line_up_and_keep_their_cells() -> None:
    text = table(["set", "SSIM"], [["mic", "0.9"], ["a|b\nc", shown(None, "{:.1f}")]])
    lines = text.splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[1] == "|:-------|-----:|"
    assert lines[3] == "| a\\|b c |    – |"


def test_labels_of_a_sheet_have_greek_letters(tmp_path: Path) -> None:
    """A font without a letter draws the same box for each that it lacks."""
    labels = []
    for letter in "αβ":
        write_sheet(tmp_path / "sheet.png", {letter: np.full((4, 8, 3), 255, np.uint8)})
        with Image.open(tmp_path / "sheet.png") as sheet:
            labels.append(np.asarray(sheet))
    assert not np.array_equal(*labels)


def test_curves_pass_through_their_values() -> None:
    series = {"ours": [0.9, 0.8, 0.7], "ceiling": [0.9, None, 0.9]}
    lines = points_of(curves(["0", "5", "20"], series, "α", "SSIM"))
    ours, ceiling = lines["ours, 0"], lines["ceiling, 0"]
    assert [len(ours), len(ceiling)] == [3, 2]
    assert ours[0] == ceiling[0]
    assert ours[1][1] - ours[0][1] == pytest.approx(ours[2][1] - ours[1][1], abs=0.01)
    assert ours[1][0] - ours[0][0] == pytest.approx(ours[2][0] - ours[1][0], abs=0.01)


def test_no_line_leads_over_a_break() -> None:
    whole = points_of(curves("abcd", {"s": [1, 2, 3, 4]}, "x", "y"))
    broken = points_of(curves("abcd", {"s": [1, 2, 3, 4]}, "x", "y", [1]))
    assert [len(line) for line in broken.values()] == [1, 3]
    assert [*broken["s, 0"], *broken["s, 1"]] == whole["s, 0"]


@pytest.mark.parametrize(
    ("curves_of", "apart", "points"),
    [(["k", "k", "", "k"], [False] * 4, [4]), ([""] * 4, [True, False, False, False], [1, 3])],
    ids=["one setting scaled", "the first of another kind"],
)
def test_a_figure_over_the_rows_is_one_line_but_for_what_stands_apart(
    curves_of: list[str], apart: list[bool], points: list[int]
) -> None:
    rows = ["a", "b", "c", "d"]
    results = {
        "picture": "displacement_error", "x_label": "", "title": "title", "rows": rows, "ticks": rows,
        "curves": curves_of, "apart": apart, "sets": [{"label": "mic"}],
        "lines": [{"set": "mic", "row": r, "scalars": {"displacement_error": 0.1 * k}} for k, r in enumerate(rows)],
    }  # fmt: skip
    assert [len(line) for line in points_of(picture(results) or "").values()] == points
