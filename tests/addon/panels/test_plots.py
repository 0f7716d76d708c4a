"""Pictures of the panels: words, ticks, curves, the legends of the colours."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from tg4mm.core.colour import to_display

pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"),
    [
        (0, 10, 5, [0, 2, 4, 6, 8, 10]),
        (0, 1.96, 5, [0, 0.5, 1, 1.5]),
        (0, 15, 5, [0, 5, 10, 15]),
        (0, 3.4e-4, 5, [0, 1e-4, 2e-4, 3e-4]),
        (0.3, 0.9, 5, [0.4, 0.6, 0.8]),
        (0, 0, 5, [0]),
        (0, float("inf"), 5, [0]),
    ],
)
def test_ticks_are_round(
    extension: ModuleType, low: float, high: float, most: int, expected: list[float]
) -> None:
    assert extension.panels.plots.ticks(low, high, most) == pytest.approx(expected)


def test_no_more_ticks_than_there_is_room_for(extension: ModuleType) -> None:
    for span in np.random.default_rng(0).uniform(1e-6, 1e6, 300):
        found = extension.panels.plots.ticks(0.0, float(span), 5)
        assert 2 <= len(found) <= 6
        assert found[-1] <= span * (1 + 1e-9)


def test_the_curve_goes_through_its_values(extension: ModuleType) -> None:
    plots = extension.panels.plots
    seconds = np.linspace(0, 2, 200)
    moved = np.stack([np.sin(3 * seconds), np.zeros(200), np.zeros(200)], axis=1)
    picture = plots.series(seconds, moved, extension.units.unit_of(None))
    red = picture[..., 0] - picture[..., 2] > 0.3
    middle, height = (plots._TOP + plots._BOTTOM) / 2, (plots._BOTTOM - plots._TOP) / 2 * 0.94
    # Up is positive, and the largest value fills the height.
    for part in (0.1, 0.26, 0.7, 0.95):
        x = plots._LEFT + (plots._RIGHT - plots._LEFT) * part
        y = np.flatnonzero(red[74:, int(x)]).mean() + 74.5
        largest = np.abs(np.sin(3 * seconds)).max()
        assert y == pytest.approx(middle - height * np.sin(3 * 2 * part) / largest, abs=3)


def test_the_current_frame_is_marked_inside_the_recording_only(extension: ModuleType) -> None:
    plots = extension.panels.plots
    picture = np.zeros((plots.SIDE, plots.SIDE, 4), np.float32)
    marked = plots.mark_time(picture, 0.25)
    columns = np.flatnonzero(marked[200, :, 0] > 0.3)
    assert columns.mean() + 0.5 == pytest.approx(plots._LEFT + 0.25 * (plots._RIGHT - plots._LEFT), abs=1)
    assert picture.max() == 0  # its input is as it was
    for part in (-0.01, 1.01):
        assert plots.mark_time(picture, part).max() == 0


def test_the_bar_of_the_legend_has_the_colours_of_the_points(extension: ModuleType) -> None:
    plots, colours = extension.panels.plots, extension.nodes.colours
    picture = plots.amplitude_legend(0.02, extension.units.unit_of(0.1))
    column = picture[:, 60, :3]
    rows = to_display(colours.amplitude_map())
    np.testing.assert_allclose(column[100], rows[-1], atol=0.02)
    np.testing.assert_allclose(column[375], rows[0], atol=0.02)
    np.testing.assert_allclose(column[238], rows[12], atol=0.02)
    assert plots.amplitude_legend(0.0, extension.units.unit_of(None)).shape == picture.shape


def test_the_wheel_has_the_colours_of_the_phases(extension: ModuleType) -> None:
    picture = extension.panels.plots.phase_legend(0.001, extension.units.unit_of(None))
    rows = to_display(extension.nodes.colours.phase_map())
    for turn in (0.0, 0.25, 0.5, 0.75, 0.125):
        x = int(200 + 75 * np.cos(2 * np.pi * turn))
        y = int(204 - 75 * np.sin(2 * np.pi * turn))
        np.testing.assert_allclose(picture[y, x, :3], rows[round(turn * 24)], atol=0.03)


def test_units_are_millimetres_where_they_can_be(extension: ModuleType) -> None:
    unit_of = extension.units.unit_of
    assert unit_of(0.1).text(0.0123456) == "1.235 mm"
    assert unit_of(0.1, digits=2).text(0.0123456) == "1.2 mm"
    assert unit_of(0.1, metric=False).text(0.0123456) == "0.01235 scene units"
    assert unit_of(None).text(0.0123456) == "0.01235 scene units"
