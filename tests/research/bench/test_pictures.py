"""Tables that line up and SVG files that stand alone."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from tests.helpers.curves import points_of
from tg4mm.research.bench.ablation.page import picture
from tg4mm.research.bench.pages.plots import curves
from tg4mm.research.bench.pages.shown import write_sheet
from tg4mm.research.bench.pages.text import shown, table


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


def test_svg_is_whole_and_holds_its_labels() -> None:
    series = {"nothing moves": [0.9, 0.8], "modal <b> $x$": [0.95, None], "ceiling": [0.99, 0.98]}
    root = ElementTree.fromstring(curves(["5", "20"], series, "α", "SSIM"))
    names = [e.text for e in root.iter() if e.tag.endswith("text")]
    assert {"nothing moves", "modal <b> $x$", "ceiling", "5", "20", "α", "SSIM"} <= set(names)


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
