"""What the viewer is made of: charts, playing time, the browser's camera."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from tg4mm.show.maps import middle_depth
from tg4mm.show.render.cameras import Camera, look_at
from tg4mm.show.view.charts import waveform_chart
from tg4mm.show.view.scene import camera_of, standpoint_of
from tg4mm.show.view.session import Clock


def test_a_waveform_goes_up_where_its_values_do():
    values = np.array([0.0, 1.0, -1.0])
    svg = str(waveform_chart(np.array([0.0, 1.0, 2.0]), values, "mm", np.full(3, 0.1)))
    points = re.search(r'class="curve" points="([^"]+)"', svg)[1].split()
    y = [float(p.split(",")[1]) for p in points]
    assert y[1] < y[0] < y[2]
    assert 'class="spread"' in svg
    ET.fromstring(svg)


def test_without_loop_it_stays_at_the_end_and_plays_again_from_the_start():
    clock = Clock(2.0, since=100.0, playing=True, loop=False)
    assert clock.at(110.0) == 2.0
    assert not clock.running(110.0)
    again = clock.changed(110.0, playing=True)
    assert again.at(110.5) == pytest.approx(0.5)


def test_a_pause_holds_the_moment():
    clock = Clock(2.0, since=0.0, playing=True).changed(0.7, playing=False)
    assert clock.at(5.0) == pytest.approx(0.7)
    assert clock.changed(6.0, playing=True).at(6.2) == pytest.approx(0.9)


@pytest.fixture
def camera():
    viewmat = look_at(np.array([1.0, -3.0, 2.0]), np.array([0.2, 0.1, 0.5]))
    K = np.array([[70.0, 0, 32], [0, 70.0, 24], [0, 0, 1]])
    return Camera("r_000", viewmat, K, 64, 48)


def pixel(camera, point):
    seen = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
    return seen[:2] / seen[2]


def from_standpoint(camera, size):
    to = standpoint_of(camera, 3.0, size[0] / size[1])
    z = to.target - to.position
    z = z / np.linalg.norm(z)
    x = np.cross(-to.up, z)
    rotation = np.stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z], axis=1)
    return camera_of(to.position, rotation, to.fov, size[0] / size[1], size)


def test_a_canvas_of_the_capture_s_shape_shows_the_same_pixels(camera):
    shown = from_standpoint(camera, (128, 96))
    point = np.array([0.1, 0.3, 0.8])
    np.testing.assert_allclose(pixel(shown, point), 2 * pixel(camera, point), atol=1e-9)


def test_the_point_to_turn_around_lies_amid_what_is_seen(camera):
    near, far = camera.position + 2 * camera.forward, camera.position + 5 * camera.forward
    behind = camera.position - camera.forward
    assert middle_depth(np.stack([near, far, behind]), np.array([1.0, 0.4, 9.0]), camera) == pytest.approx(
        2.0
    )
    assert middle_depth(np.stack([behind]), np.ones(1), camera) == 1.0
