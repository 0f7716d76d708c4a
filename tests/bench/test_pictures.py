"""Tables that line up and SVG files that stand alone."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from tg4mm.bench.ablation_page import picture
from tg4mm.bench.chart import curves
from tg4mm.bench.table import shown, table


def test_table_columns_line_up_and_keep_their_cells() -> None:
    text = table(["set", "SSIM"], [["mic", "0.9"], ["a|b\nc", shown(None, "{:.1f}")]])
    lines = text.splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[1] == "|:-------|-----:|"
    assert lines[3] == "| a\\|b c |    – |"


def test_svg_is_whole_and_holds_its_labels() -> None:
    series = {"nothing moves": [0.9, 0.8], "modal <b>": [0.95, None], "ceiling": [0.99, 0.98]}
    root = ElementTree.fromstring(curves(["5", "20"], series, "α", "SSIM"))
    names = [e.text for e in root.iter() if e.tag.endswith("text")]
    assert {"nothing moves", "modal <b>", "ceiling", "5", "20", "α", "SSIM"} <= set(names)
    lines = [e for e in root.iter() if e.tag.endswith("polyline")]
    assert [line.get("class") for line in lines] == ["line-rest", "line-s0", "line-rest"]
    (style,) = [e.text for e in root.iter() if e.tag.endswith("style")]
    assert all(f".{line.get('class')}{{" in (style or "") for line in lines)


def test_long_labels_get_room() -> None:
    def width(name: str) -> float:
        root = ElementTree.fromstring(curves(["5", "20"], {name: [0.9, 0.8]}, "α", "SSIM"))
        return float(root.get("viewBox", "").split()[2])

    assert width("short") == 640
    assert width("paper-tuned, modal's time: linear") > 740


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
    root = ElementTree.fromstring(picture(results) or "")
    found = [e.get("points", "").split() for e in root.iter() if e.tag.endswith("polyline")]
    assert [len(line) for line in found] == points
