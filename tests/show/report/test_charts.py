"""Charts as inline SVG: they follow the page's colours, and do not clash."""

import re
from xml.etree import ElementTree

from tg4mm.core.pages.charts import OURS, chart
from tg4mm.core.pages.plotstyle import COLOURS


def two(label: str = "b") -> str:
    def draw(axes):
        axes.plot([0, 1], [0, 1], "o-", color=OURS)
        axes.plot([0, 1], [1, 0], color=COLOURS[0])
        axes.set(xlabel="a <b> & c", ylabel="y")

    return str(chart(draw, label))


def test_colours_are_the_pages_variables():
    text = two()
    assert "stroke: var(--ours)" in text
    assert "stroke: var(--axis-1)" in text
    assert not re.findall(r"#[0-9a-f]{6}\b(?!-)", text.replace("url(#", "url(").replace('href="#', 'href="'))


def test_a_chart_is_xml_with_escaped_text_and_nothing_of_a_file():
    root = ElementTree.fromstring(two('<x> "y"'))
    assert root.get("aria-label") == '<x> "y"'
    assert any(e.text == "a <b> & c" for e in root.iter("{http://www.w3.org/2000/svg}text"))
    assert "<style" not in two()
    assert "<metadata" not in two()
    assert "<?xml" not in two()


def test_names_in_two_charts_differ_and_are_all_used():
    def flat(axes):
        axes.plot([0, 2], [0, 0], "o-")

    one, other = two(), str(chart(flat, "c"))
    names = [set(re.findall(r'\bid="([^"]*)"', text)) for text in (one, other)]
    assert names[0]
    assert not names[0] & names[1]
    for text, own in zip((one, other), names, strict=True):
        assert set(re.findall(r'(?:url\(|href=")#([^)"]+)', text)) == own


def test_the_same_drawing_gives_the_same_text():
    assert two() == two()
