"""Drawings say what they show, hold what they were given, and escape what is not theirs."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from tg4mm.show.view.charts import block, spectrum_chart, waveform_chart


def rects(svg: str, style: str) -> list[dict[str, str]]:
    root = ET.fromstring(svg.replace("&nbsp;", " "))
    return [e.attrib for e in root.iter("rect") if e.get("class") == style]


def test_every_labelled_stem_can_be_clicked_nearest_to_it():
    svg = str(spectrum_chart([2.0, 5.0, 6.0], [1.0, 3.0, 0.1], 15.0, "mm", None, ["2 Hz", "5 Hz", ""]))
    hits = rects(svg, "hit")
    assert [hit["data-peak"] for hit in hits] == ["2 Hz", "5 Hz"]
    ends = [(float(h["x"]), float(h["x"]) + float(h["width"])) for h in hits]
    assert ends[0][1] == pytest.approx(ends[1][0], abs=0.2)
    stems = [float(x) for x in re.findall(r'class="stem[^"]*" x1="([\d.]+)"', svg)]
    assert ends[0][0] <= stems[0] <= ends[0][1] <= stems[1] <= ends[1][1]


def test_stems_of_the_band_stand_out():
    svg = str(spectrum_chart([2.0, 5.0], [1.0, 3.0], 15.0, "mm", (4.0, 6.0)))
    assert svg.count('class="stem in"') == 1
    assert svg.count('class="stem"') == 1
    assert len(rects(svg, "band")) == 1
    assert "peak (mm)" in svg
    assert "frequency (Hz)" in svg


def test_a_spectrum_of_zeros_or_of_nothing_is_still_drawn():
    for svg in (spectrum_chart([], [], 15.0, "mm"), spectrum_chart([3.0], [0.0], 15.0, "mm")):
        assert "nan" not in svg
        ET.fromstring(str(svg))


def test_a_waveform_goes_up_where_its_values_do():
    values = np.array([0.0, 1.0, -1.0])
    svg = str(waveform_chart(np.array([0.0, 1.0, 2.0]), values, "mm", np.full(3, 0.1)))
    points = re.search(r'class="curve" points="([^"]+)"', svg)[1].split()
    y = [float(p.split(",")[1]) for p in points]
    assert y[1] < y[0] < y[2]
    assert 'class="spread"' in svg
    ET.fromstring(svg)


def test_a_motionless_waveform_is_a_line():
    svg = str(waveform_chart(np.array([0.0, 1.0]), np.zeros(2), "mm"))
    assert "nan" not in svg


def test_text_is_escaped():
    assert "<b>" not in block("a folder named <b>")
