"""Pictures, charts, colours and maps show the numbers that were put in."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.core.colour import amount_colours, phase_colours, srgb_of_oklch
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import Magnification
from tg4mm.core.pages.charts import OURS, chart
from tg4mm.core.pages.plotstyle import COLOURS
from tg4mm.core.pages.svg import colour_bar, nice_ticks, number, phase_bar
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.maps import image_motion, leading_modes, motion_maps, strongest, uncertainty_map
from tg4mm.show.render.cameras import capture_cameras
from tg4mm.show.report.figures import (
    Line,
    contact_sheet,
    line_that_moves,
    map_picture,
    phase_picture,
    slice_picture,
)
from tg4mm.show.weights import blending_weights


def moving_dot(axis: str) -> np.ndarray:
    """A dot that moves along column 20 (or row 20) between pixels 10 and 14 of 40."""
    video = np.ones((8, 40, 40, 3))
    for t in range(8):
        place = 10 + t % 5
        video[(t, place, 20) if axis == "column" else (t, 20, place)] = 0
    return video


@pytest.mark.parametrize("axis", ["row", "column"])
def test_the_line_follows_the_motion(axis):
    line = line_that_moves(moving_dot(axis), margin=0.1)
    assert (line.axis, line.index) == (axis, 20)
    assert (line.start, line.stop) == (6, 19)


@pytest.mark.parametrize("axis", ["row", "column"])
def test_slices_hold_the_line_over_time(axis):
    video = (moving_dot(axis) * 255).astype(np.uint8)
    picture = slice_picture(video, Line(axis, 20, 6, 19), periods=2)
    over_time = picture if axis == "row" else picture.transpose(1, 0, 2)
    assert over_time.shape == (16, 13, 3)
    assert [int(row[:, 0].argmin()) + 6 for row in over_time] == [10 + t % 5 for t in range(8)] * 2


def test_a_contact_sheet_keeps_order_and_leaves_gaps_clear():
    images = [np.full((8, 8, 3), 50 * i, np.uint8) for i in range(5)]
    sheet = contact_sheet(images, columns=3, gap=2, edge=8)
    assert sheet.shape == (18, 28, 4)
    assert sheet[4, 14, 0] == 50
    assert sheet[14, 4, 0] == 150
    assert sheet[4, 9, 3] == 0
    assert sheet[14, 24, 3] == 0


def test_amounts_become_the_colours_of_the_scale():
    picture = map_picture(np.array([[0.0, 1.0, 2.0]]), 2.0, np.array([[1.0, 1.0, 0.0]]))
    expected = np.round(amount_colours(np.array([0.0, 0.5, 1.0])) * 255)
    np.testing.assert_allclose(picture[0, :, :3], expected, atol=1)
    np.testing.assert_array_equal(picture[0, :, 3], [255, 255, 0])


def test_phase_fades_to_grey_where_nothing_moves():
    picture = phase_picture(np.array([[1.0, 1.0]]), np.array([[0.0, 1.0]]), np.ones((1, 2)))
    assert len(set(picture[0, 0, :3].tolist())) == 1
    assert len(set(picture[0, 1, :3].tolist())) > 1


def parse(svg):
    return ElementTree.fromstring(str(svg))


def texts(svg):
    return [element.text for element in parse(svg).iter("text")]


def test_colour_bars_have_ticks_up_to_the_top():
    assert {"0", "0.5", "1"} <= set(texts(colour_bar(1.0, "mm", "size")))
    assert "size (mm)" in texts(colour_bar(1.0, "mm", "size"))
    assert "180°" in texts(phase_bar())
    parse(colour_bar(0.0, "mm", "size"))


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


def luminance(srgb):
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def test_greys_of_oklab_are_greys_and_white_is_white():
    np.testing.assert_allclose(srgb_of_oklch(np.array(1.0), np.array(0.0), np.array(0.0)), 1.0, atol=1e-3)
    grey = srgb_of_oklch(np.array(0.5), np.array(0.0), np.array(123.0))
    np.testing.assert_allclose(grey, grey[0], atol=1e-6)


def test_more_is_lighter():
    light = luminance(amount_colours(np.linspace(0, 1, 200)))
    assert (np.diff(light) > 0).all()
    assert light[0] < 0.03
    assert light[-1] > 0.8


def test_phases_meet_at_half_a_turn_and_are_equally_light():
    np.testing.assert_allclose(phase_colours(np.array(np.pi)), phase_colours(np.array(-np.pi)), atol=1e-9)
    light = luminance(phase_colours(np.linspace(-np.pi, np.pi, 100)))
    assert light.max() - light.min() < 0.15
    opposite = phase_colours(np.array([0.0, np.pi]))
    assert np.abs(opposite[0] - opposite[1]).max() > 0.3


def motion_of(*amplitudes: float) -> ModalMotion:
    displacement = np.zeros((len(amplitudes), 2, 3), np.complex64)
    displacement[:, 0, 0] = amplitudes
    freqs = np.arange(1.0, len(amplitudes) + 1)
    return ModalMotion(freqs, displacement, np.zeros_like(displacement), 30.0, 30)


def test_leading_modes_are_the_strong_ones_in_the_band():
    motion = motion_of(1.0, 0.2, 3.0, 2.0)
    weights = np.ones(2)
    assert leading_modes(motion, weights) == [2, 3]
    assert leading_modes(motion, weights, Magnification.of(1.0, (0.5, 2.5))) == [0]
    assert leading_modes(motion, weights, Magnification.of(1.0, (1.5, 3.5)), most=5) == [2]
    assert strongest(motion, weights, Magnification.of(1.0, (0.5, 2.5))) == 0
    assert leading_modes(motion, np.array([0.0, 1.0]), most=1)  # nothing seen moves: still an answer
    with pytest.raises(RunError, match=r"band \(8, 9\) Hz holds none.*1, 2, 3, 4 Hz"):
        strongest(motion, weights, Magnification.of(1.0, (8.0, 9.0)))


def test_maps_show_the_true_amplitude_and_phase_of_each_part(tmp_path):
    gaussians, motion = make_synthetic_dataset(
        tmp_path, n_views=2, n_timesteps=2, size=64, freqs=(3.0, 5.0), amplitude=0.01, n_test=0
    )
    capture = load_capture(tmp_path)
    camera = capture_cameras(capture)[1]
    direction = np.array([0.8, 0.0, 0.6])
    maps = motion_maps(gaussians, motion, 1, direction, camera)
    moving = maps.amplitude > 0.0095
    assert 30 < moving.sum() < 1500  # the ball
    assert maps.amplitude.max() == pytest.approx(0.01, rel=1e-3)
    np.testing.assert_allclose(maps.phase[moving], -np.pi / 2, atol=0.05)  # a sine: zero at timestep 0
    assert (maps.amplitude[maps.opacity < 1e-6] == 0).all()
    weights = blending_weights(gaussians, capture)
    assert image_motion(gaussians, motion.displacement[1], weights, camera) > 0
    assert image_motion(gaussians, motion.displacement[1] * 0, weights, camera) == 0


def test_uncertainty_shows_as_the_peak_of_a_sinusoid(tmp_path):
    gaussians, motion = make_synthetic_dataset(tmp_path, n_views=2, n_timesteps=2, size=48, n_test=0)
    camera = capture_cameras(load_capture(tmp_path))[0]
    deviation = np.where(motion.displacement[0].any(1), 0.004, 0.001)  # what moves is less sure
    shown = uncertainty_map(gaussians, deviation, camera)
    maps = motion_maps(gaussians, motion, 0, np.array([1.0, 0, 0]), camera)
    moving, still = maps.amplitude > 0.98 * maps.amplitude.max(), (maps.amplitude == 0) & (maps.opacity > 0.5)
    assert moving.sum() > 10
    assert still.sum() > 10
    np.testing.assert_allclose(shown[moving], np.sqrt(2) * 0.004, rtol=0.05)
    np.testing.assert_allclose(shown[still], np.sqrt(2) * 0.001, rtol=1e-4)
    assert not shown[maps.opacity < 1e-6].any()
