"""Charts of a dataset's report show the numbers they are given."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from dataset_gen.report.chart import spectrum_chart, time_chart


def paths(svg: str, colour: str) -> list[np.ndarray]:
    """Points [P, 2] of every path that is filled or drawn in a colour of the page; y points down."""
    ElementTree.fromstring(svg)
    found = re.findall(r'<path d="([^"]*)"[^>]*style="([^"]*)"', svg.replace("\n", " "))
    shown = [d for d, style in found if f"fill: var({colour})" in style or f"stroke: var({colour})" in style]
    return [np.array([float(n) for n in re.findall(r"-?[\d.]+", d)]).reshape(-1, 2) for d in shown]


def test_bars_are_as_high_as_their_numbers_and_strong_ones_stand_out() -> None:
    strong = np.array([False, True, True])
    svg = str(spectrum_chart(np.array([0.0, 3.0, 6.0]), np.array([1.0, 2.0, 4.0]), "mm", strong))
    weak = [np.ptp(p[:, 1]) for p in paths(svg, "--still") if len(p) == 4 and np.ptp(p[:, 0]) > 1]
    found = [np.ptp(p[:, 1]) for p in paths(svg, "--ours")]
    assert len(weak) == 1
    assert np.array(found) / weak[0] == pytest.approx([2, 4], rel=1e-3)
    assert "amplitude (mm)" in svg


def test_a_curve_passes_through_its_values_and_zero_lies_in_the_middle() -> None:
    values = np.array([0.0, 1.0, -0.5])
    svg = str(time_chart(np.array([0.0, 0.1, 0.2]), values, "<m>"))
    (curve,) = (p for p in paths(svg, "--ours") if len(p) == 3 and np.ptp(p[:, 0]) > 20)
    up = curve[0, 1] - curve[:, 1]
    assert up / up[1] == pytest.approx(values, abs=1e-3)
    assert "displacement (&lt;m&gt;)" in svg


def test_nothing_at_all_is_drawn_too() -> None:
    charts = (
        time_chart(np.zeros(1), np.zeros(1), "mm"),
        spectrum_chart(np.zeros(1), np.zeros(1), "mm", np.zeros(1, bool)),
    )
    assert all(str(chart).startswith("<svg") and "nan" not in str(chart) for chart in charts)
