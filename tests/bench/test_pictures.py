"""Tables that line up and SVG files that stand alone."""

from __future__ import annotations

from xml.etree import ElementTree

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
    assert width("paper-small, modal's time: linear") > 740
