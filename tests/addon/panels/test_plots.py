"""Pictures of the panels: ticks, curves, legends, the spectrum beside the band and when it is drawn anew."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.colour import to_display
from tg4mm.core.splatfile import read_splat, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import import_splat  # noqa: E402


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


TURNS = np.exp(2j * np.pi * np.arange(3600) / 3600)


def amplitudes(path: Path) -> np.ndarray:
    """[M, N] the longest excursion of every Gaussian at each frequency, by trying."""
    phasors = read_splat(path).displacement
    paths = (phasors[:, :, None, :] * TURNS[None, None, :, None]).real
    return np.linalg.norm(paths, axis=3).max(axis=2)


def picture_of(extension: ModuleType, obj: Any) -> tuple[Any, ...]:
    return extension.panels.panel.spectrum_picture(bpy.context, obj)


def test_strength_is_the_rms_by_opacity_or_the_largest(extension: ModuleType, splat_path: Path) -> None:
    obj = import_splat(splat_path)
    a, w = amplitudes(splat_path), read_splat(splat_path).opacities
    expected = np.sqrt((w * a**2).sum(axis=1) / w.sum())
    np.testing.assert_allclose(extension.panels.analysis.mode_strengths(obj, "RMS"), expected, rtol=1e-4)
    np.testing.assert_allclose(
        extension.panels.analysis.mode_strengths(obj, "PEAK"), a.max(axis=1), rtol=1e-4
    )
    assert np.abs(a.max(axis=1) / expected - 1).min() > 0.1


@pytest.mark.parametrize(
    ("freqs", "strengths", "bin_hz", "expected"),
    [
        ((5, 3, 4, 1, 2), (0, 1, 3, 0, 5), 1.0, (2, 4)),  # in no order
        ((1, 2, 3), (9, 2, 1), 1.0, (1,)),  # the first
        ((1, 2, 3), (1, 2, 9), 1.0, (3,)),  # the last
        ((1, 2, 3, 4), (0, 7, 7, 0), 1.0, (2,)),  # alike
        ((1, 2, 3, 4, 5), (0, 100, 1, 4, 0), 1.0, (2,)),  # 4 is too small
        ((1, 2, 3), (0, 0, 0), 1.0, ()),
        ((), (), 1.0, ()),
        ((2, 5), (2.0, 1.0), 0.5, (2, 5)),  # nothing was stored between them
        ((2, 5), (1.0, 2.0), 5.0, (5,)),  # one bin apart
        ((4, 5, 6, 7), (5.0, 10.0, 4.0, 2.0), 1.0, (5,)),  # a peak with its skirts
        ((4, 5, 6, 7), (5.0, 10.0, 4.0, 4.5), 1.0, (5,)),  # a ripple is no dip
        ((4, 5, 6, 7), (5.0, 10.0, 2.0, 4.5), 1.0, (5, 7)),
    ],
)
def test_peaks_are_apart_by_a_dip_or_an_empty_bin(
    extension: ModuleType, freqs: tuple[float], strengths: tuple[float], bin_hz: float, expected: tuple[float]
) -> None:
    assert tuple(freqs[k] for k in extension.nodes.clock.peaks(freqs, strengths, bin_hz)) == expected


def test_band_around_a_peak_is_set_by_its_button(extension: ModuleType, splat_path: Path) -> None:
    obj = import_splat(splat_path)
    assert extension.panels.analysis.band(obj) == (0.0, 12.0)  # half of 24 Hz
    for width, frequency, expected in (
        (2.0, 5.0, (4.0, 6.0)),
        (8.0, 3.0, (0.0, 7.0)),
        (0.0, 7.5, (7.0, 8.0)),
    ):
        assert bpy.ops.tg4mm.band(frequency=frequency, width=width) == {"FINISHED"}
        assert extension.panels.analysis.band(obj) == pytest.approx(expected)
    assert extension.panels.analysis.active_modes(obj) == [2]
    assert bpy.ops.tg4mm.band() == {"FINISHED"}
    assert extension.panels.analysis.band(obj) == (0.0, 12.0)


def test_a_file_without_motion_has_no_band(extension: ModuleType, tmp_path: Path) -> None:
    write_splat(tmp_path / "still.ply", some_splat(5, (), degree=0))
    import_splat(tmp_path / "still.ply")
    assert not bpy.ops.tg4mm.band.poll()
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.tg4mm.band(frequency=3.0)


def test_bars_are_as_high_as_the_modes_are_strong(extension: ModuleType) -> None:
    plots, unit = extension.panels.plots, extension.units.unit_of(None)
    freqs, strengths = (2.0, 5.0, 8.0), (0.5, 2.0, 1.0)
    picture = plots.spectrum(freqs, strengths, (4.0, 6.0), 10.0, "Amplitude", unit)
    bottom = round(plots._BOTTOM) - 3
    heights, colours = [], []
    for f in freqs:
        x = round(plots._LEFT + (plots._RIGHT - plots._LEFT) * f / 10.0)
        column = picture[:, x, :3]
        same = np.abs(column[: bottom + 1] - column[bottom]).max(axis=1) < 0.02
        heights.append(len(same) - 1 - np.flatnonzero(~same).max())
        colours.append(tuple(np.round(column[bottom], 2)))
    np.testing.assert_allclose(np.array(heights) / heights[1], [0.25, 1.0, 0.5], atol=0.03)
    assert colours[0] == colours[2] != colours[1]  # inside the band and outside


def test_the_picture_is_drawn_once_for_each_band(
    extension: ModuleType, splat_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    obj, pictures = import_splat(splat_path), extension.panels.pictures.shared()
    drawn, draw = [], extension.panels.plots.spectrum
    monkeypatch.setattr(extension.panels.plots, "spectrum", lambda *a: drawn.append(a) or draw(*a))
    key = picture_of(extension, obj)
    for _ in range(3):  # a panel is drawn many times
        pictures.icon(*key)
    assert (pictures.waiting, drawn) == (1, [])
    pictures.refresh()
    pictures.icon(*picture_of(extension, obj))
    assert (pictures.waiting, len(drawn)) == (0, 1)
    bpy.ops.tg4mm.band(frequency=5.0)
    pictures.icon(*picture_of(extension, obj))
    assert pictures.waiting == 1
    pictures.refresh()
    assert len(drawn) == 2
    shown = pictures.pixels(*picture_of(extension, obj))
    np.testing.assert_allclose(shown / 255, draw(*picture_of(extension, obj)[1:]), atol=0.51 / 255)
