"""Charts from known numbers are valid XML with marks where the numbers say."""

from itertools import pairwise
from xml.etree import ElementTree

import pytest

from tg4mm.report.svg import (
    TOP,
    Series,
    below,
    colour_bar,
    nice_ticks,
    number,
    phase_bar,
    score_chart,
)  # fmt: skip


def parse(svg):
    return ElementTree.fromstring(str(svg))


def texts(svg):
    return [element.text for element in parse(svg).iter("text")]


def test_curves_pass_through_their_values():
    series = [Series("ours", [0.9, 0.8, 0.7], "ours"), Series("ceiling", [0.9, None, 0.9], "ceiling")]
    root = parse(score_chart(["0", "5", "20"], series, "α", "SSIM"))
    ours, ceiling = (
        [tuple(map(float, p.split(","))) for p in line.get("points").split()]
        for line in root.iter("polyline")
    )
    assert len(ours) == 3
    assert len(ceiling) == 2
    assert ours[1][1] - ours[0][1] == pytest.approx(ours[2][1] - ours[1][1], abs=0.2)
    assert ours[0][1] == ceiling[0][1]
    assert {"ours", "ceiling", "SSIM", "α", "20"} <= set(
        texts(score_chart(["0", "5", "20"], series, "α", "SSIM"))
    )


def test_end_labels_do_not_lie_on_each_other():
    series = [Series(name, [0.9, 0.9], "ours") for name in ("a", "b", "c")]
    labels = [
        e for e in parse(score_chart(["0", "5"], series, "x", "y")).iter("text") if e.text in {"a", "b", "c"}
    ]
    heights = sorted(float(e.get("y")) for e in labels)
    assert heights[1] - heights[0] >= 15
    assert heights[2] - heights[1] >= 15


@pytest.mark.parametrize("count", [3, 13, 30])
def test_end_labels_stay_above_the_names_of_the_positions(count: int):
    """All curves end at the bottom. More labels than there is room for reach as far below as is said."""
    series = [Series(f"s{i}", [0.9, 0.1], "ours") for i in range(count)] + [Series("top", [0.9, 0.9], "ours")]
    root = parse(score_chart(["first", "last"], series, "x", "y"))
    heights = {e.text: float(e.get("y")) for e in root.iter("text") if e.get("y")}
    labels = sorted(y for name, y in heights.items() if name == "top" or name.startswith("s"))
    assert max(labels) <= heights["last"] - 10 + below(count + 1)
    assert min(b - a for a, b in pairwise(labels)) >= 15
    assert min(labels) >= TOP
    assert below(13) == 0 < below(30)


def test_no_line_leads_over_a_break():
    (whole,) = parse(score_chart("abcd", [Series("s", [1, 2, 3, 4], "ours")], "x", "y")).iter("polyline")
    broken = parse(score_chart("abcd", [Series("s", [1, 2, 3, 4], "ours", [1])], "x", "y")).iter("polyline")
    first, rest = (line.get("points").split() for line in broken)
    assert (len(first), len(rest)) == (1, 3)
    assert first + rest == whole.get("points").split()


def test_rules_end_before_the_labels():
    root = parse(score_chart(["0", "5"], [Series("curve", [0.0, 1.0], "ours")], "x", "y"))
    (label,) = (float(e.get("x")) for e in root.iter("text") if e.text == "curve")
    assert all(float(e.get("x2")) < label for e in root.iter("line"))


def test_text_is_escaped():
    svg = score_chart(["<script>"], [Series("<i>", [1], "ours")], "<script>x</script>", 'a"&b')
    assert "<script>" not in svg
    assert texts(svg)[0] == 'a"&b'
    assert "<script>" not in colour_bar(1.0, "<script>", "<b>")


def test_colour_bars_have_ticks_up_to_the_top():
    assert {"0", "0.5", "1"} <= set(texts(colour_bar(1.0, "mm", "size")))
    assert "size (mm)" in texts(colour_bar(1.0, "mm", "size"))
    assert "180°" in texts(phase_bar())
    parse(colour_bar(0.0, "mm", "size"))


def test_equal_bars_have_equal_markup():
    assert colour_bar(0.3, "mm", "size") == colour_bar(0.3, "mm", "size")


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 1, [0, 0.25, 0.5, 0.75, 1]),
        (0, 0.013, [0, 0.005, 0.01]),
        (0.88, 1.0, [0.9, 0.95, 1.0]),
        (2, 2, [2]),
    ],
)
def test_ticks_are_round_numbers_inside(low, high, expected):
    assert nice_ticks(low, high) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"),
        (5, "5"),
        (0.00641234, "0.00641"),
        (123456.0, "123456"),
        (100.0, "100"),
        (1234567.0, "1.23·10⁶"),
        (0.00001234, "1.23·10⁻⁵"),
        (float("nan"), "–"),
        (-2.5, "-2.5"),
    ],
)
def test_numbers_are_short(value, text):
    assert number(value) == text


def test_numbers_in_tables_keep_their_zeros():
    assert number(0.22, trim=False) == "0.220"
