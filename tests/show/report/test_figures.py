"""Pictures, charts, colours and maps show the numbers that were put in; text in a page stays text."""

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset, with_phasors
from tests.show.report.page_checks import read_page
from tg4mm.capture import load_capture
from tg4mm.core.pages import page as p
from tg4mm.core.pages.charts import colour_bar
from tg4mm.show.maps import blending_weights, image_motion, motion_maps, uncertainty_map
from tg4mm.show.render.cameras import capture_cameras
from tg4mm.show.report.figures import SliceLine, slice_picture

EVIL = "<script>alert('x')</script>\"><img src=x onerror=alert(1)>"


def moving_dot(axis):
    """A dot that moves along column 20 (or row 20) between pixels 10 and 14 of 40."""
    video = np.ones((8, 40, 40, 3))
    for t in range(8):
        place = 10 + t % 5
        video[(t, place, 20) if axis == "column" else (t, 20, place)] = 0
    return video


@pytest.mark.parametrize("axis", ["row", "column"])
def test_slices_hold_the_line_over_time(axis):
    video = (moving_dot(axis) * 255).astype(np.uint8)
    picture = slice_picture(video, SliceLine(axis, 20, 6, 19), periods=2)
    over_time = picture if axis == "row" else picture.transpose(1, 0, 2)
    assert over_time.shape == (16, 13, 3)
    assert [int(row[:, 0].argmin()) + 6 for row in over_time] == [10 + t % 5 for t in range(8)] * 2


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
    moved = image_motion(gaussians, motion, weights, camera)
    still = image_motion(gaussians, with_phasors(motion, 0 * motion.displacement), weights, camera)
    assert moved.shape == still.shape == motion.freqs_hz.shape
    assert moved[1] > 0
    assert not still.any()


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


def page(text):
    figure = p.Figure([p.picture(np.zeros((2, 2, 3)), text), p.missing(text, text)], text, controls=True)
    chart = p.Figure([p.drawing(colour_bar(1.0, text, text))], text, width="narrow")
    table = p.Table([text, text], [[text, text]], text, ["ours"])
    blocks = [p.Text(text), p.Text(text, "note"), figure, chart, table, p.Commands([(text, text)])]
    stats, sections = [p.Stat(text, text, text, text)], [p.Section(text, blocks)]
    return p.render_page(p.Page(text, text, text, stats, [figure], sections, text))


def test_every_string_is_escaped_wherever_it_stands():
    harmless, evil = read_page(page("harmless")), read_page(page(EVIL))
    assert evil.tags == harmless.tags
    assert not evil.handlers
    assert "".join(evil.text).count(EVIL) == "".join(harmless.text).count("harmless") > 10
