"""Pictures of the panels: ticks, curves, legends, the spectrum beside the band and when it is drawn anew."""

import numpy as np
import pytest

from tg4mm.core.splatfile import read_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import import_splat  # noqa: E402

TURNS = np.exp(2j * np.pi * np.arange(3600) / 3600)


def test_the_curve_goes_through_its_values(extension):
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


def amplitudes(path):
    """[M, N] the longest excursion of every Gaussian at each frequency, by trying."""
    phasors = read_splat(path).displacement
    paths = (phasors[:, :, None, :] * TURNS[None, None, :, None]).real
    return np.linalg.norm(paths, axis=3).max(axis=2)


def picture_of(extension, obj):
    return extension.panels.analysis.spectrum_picture(bpy.context, obj)


def test_strength_is_the_rms_by_opacity_or_the_largest(extension, splat_path):
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
def test_peaks_are_apart_by_a_dip_or_an_empty_bin(extension, freqs, strengths, bin_hz, expected):
    assert tuple(freqs[k] for k in extension.nodes.clock.peaks(freqs, strengths, bin_hz)) == expected


def test_band_around_a_peak_is_set_by_its_button(extension, splat_path):
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


def test_bars_are_as_high_as_the_modes_are_strong(extension):
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


def test_the_picture_is_drawn_once_for_each_band(extension, splat_path, monkeypatch):
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
    assert (pictures.waiting, len(drawn)) == (0, 2)  # by the button: no panel shows the band before
    shown = pictures.pixels(*picture_of(extension, obj))
    np.testing.assert_allclose(shown / 255, draw(*picture_of(extension, obj)[1:]), atol=0.51 / 255)
