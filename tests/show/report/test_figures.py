"""Pictures, charts, colours and maps show the numbers that were put in; what a page is told stays text."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tests.show.report.page_checks import read_page
from tg4mm.capture import load_capture
from tg4mm.core.colour import amount_colours, phase_colours, srgb_of_oklch
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import Magnification
from tg4mm.core.pages.charts import OURS, chart
from tg4mm.core.pages.page import (
    Commands,
    Figure,
    Page,
    Section,
    Stat,
    Table,
    Text,
    drawing,
    missing,
    picture,
    render_page,
)
from tg4mm.core.pages.plotstyle import COLOURS
from tg4mm.core.pages.svg import colour_bar
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.maps import image_motion, leading_modes, motion_maps, strongest, uncertainty_map
from tg4mm.show.render.cameras import capture_cameras
from tg4mm.show.report.figures import (
    Line,
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


def two(label: str = "b") -> str:
    def draw(axes):
        axes.plot([0, 1], [0, 1], "o-", color=OURS)
        axes.plot([0, 1], [1, 0], color=COLOURS[0])
        axes.set(xlabel="a <b> & c", ylabel="y")

    return str(chart(draw, label))


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


EVIL = "<script>alert('x')</script>\"><img src=x onerror=alert(1)>"


def page(text: str) -> str:
    figure = Figure([picture(np.zeros((2, 2, 3)), text), missing(text, text)], text, controls=True)
    chart = Figure([drawing(colour_bar(1.0, text, text))], text, width="narrow")
    table = Table([text, text], [[text, text]], text, ["ours"])
    blocks = [Text(text), Text(text, "note"), figure, chart, table, Commands([(text, text)])]
    return render_page(
        Page(text, text, text, [Stat(text, text, text, text)], [figure], [Section(text, blocks)], text)
    )


def test_every_string_is_escaped_wherever_it_stands():
    harmless, evil = read_page(page("harmless")), read_page(page(EVIL))
    assert evil.tags == harmless.tags
    assert not evil.handlers
    assert "".join(evil.text).count(EVIL) == "".join(harmless.text).count("harmless") > 10
