"""Colour bars are valid XML with round numbers; numbers are short."""

from xml.etree import ElementTree

import pytest

from tg4mm.core.pages.svg import colour_bar, nice_ticks, number, phase_bar


def parse(svg):
    return ElementTree.fromstring(str(svg))


def texts(svg):
    return [element.text for element in parse(svg).iter("text")]


def test_text_is_escaped():
    bar = colour_bar(1.0, "<script>", 'a"&b')
    assert "<script>" not in bar
    assert 'a"&b (<script>)' in texts(bar)


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
