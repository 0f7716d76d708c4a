"""What the viewer is made of: bands and charts, playing time, and the browser's camera."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from tg4mm.show.maps import middle_depth
from tg4mm.show.render.cameras import Camera, look_at
from tg4mm.show.view.cameras import camera_of, overview, standpoint_of
from tg4mm.show.view.charts import block, spectrum_chart, waveform_chart
from tg4mm.show.view.colours import band_around, main_peaks
from tg4mm.show.view.session import Clock, slow_enough


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


def test_text_is_escaped():
    assert "<b>" not in block("a folder named <b>")


def test_stems_of_the_band_stand_out():
    svg = str(spectrum_chart([2.0, 5.0], [1.0, 3.0], 15.0, "mm", (4.0, 6.0)))
    assert svg.count('class="stem in"') == 1
    assert svg.count('class="stem"') == 1
    assert len(rects(svg, "band")) == 1
    assert "peak (mm)" in svg
    assert "frequency (Hz)" in svg


FREQUENCIES = np.array([3.4, 3.6, 7.0, 12.0])


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_the_band_around_a_peak_holds_that_peak_alone(frequency):
    low, high = band_around(float(frequency), FREQUENCIES, 15.0)
    inside = FREQUENCIES[(low <= FREQUENCIES) & (high >= FREQUENCIES)]
    assert inside.tolist() == [frequency]


def test_faint_frequencies_get_no_button():
    peaks = np.array([1.0, 0.5, 0.02, 0.06])
    assert main_peaks(FREQUENCIES, peaks, 2.0).tolist() == [3.4, 3.6, 12.0]


def test_it_plays_at_its_speed_and_starts_anew_at_the_end():
    clock = Clock(2.0, since=100.0, speed=0.5, playing=True)
    assert clock.at(101.0) == pytest.approx(0.5)
    assert clock.at(105.0) == pytest.approx(0.5)  # 2.5 s of a capture of 2 s


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


def test_another_speed_changes_nothing_at_that_moment():
    clock = Clock(2.0, playing=True)
    assert clock.changed(0.8, speed=0.1).at(0.8) == pytest.approx(0.8)
    assert clock.changed(0.8, speed=0.1).at(1.8) == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("frequency", "speed"), [(0.5, 1.0), (3.0, 1.0), (5.0, 0.5), (100.0, 0.02), (1e4, 0.01)]
)
def test_fast_motion_starts_in_slow_motion(frequency, speed):
    assert slow_enough(frequency) == speed


@pytest.fixture
def camera() -> Camera:
    viewmat = look_at(np.array([1.0, -3.0, 2.0]), np.array([0.2, 0.1, 0.5]))
    K = np.array([[70.0, 0, 32], [0, 70.0, 24], [0, 0, 1]])
    return Camera("r_000", viewmat, K, 64, 48)


def pixel(camera: Camera, point: np.ndarray) -> np.ndarray:
    seen = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
    return seen[:2] / seen[2]


def from_standpoint(camera: Camera, size: tuple[int, int]) -> Camera:
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


@pytest.mark.parametrize("size", [(200, 96), (96, 200)])
def test_any_other_canvas_shows_all_of_the_picture(camera, size):
    shown = from_standpoint(camera, size)
    corner = np.linalg.inv(camera.K) @ [0.0, 0.0, 1.0]
    point = camera.position + camera.viewmat[:3, :3].T @ corner * 3
    u, v = pixel(shown, point)
    assert -1e-6 <= u <= size[0]
    assert -1e-6 <= v <= size[1]
    assert min(u, v) == pytest.approx(0, abs=1e-6)


def test_the_point_to_turn_around_lies_amid_what_is_seen(camera):
    near, far = camera.position + 2 * camera.forward, camera.position + 5 * camera.forward
    behind = camera.position - camera.forward
    assert middle_depth(np.stack([near, far, behind]), np.array([1.0, 0.4, 9.0]), camera) == pytest.approx(
        2.0
    )
    assert middle_depth(np.stack([behind]), np.ones(1), camera) == 1.0


def test_the_overview_sees_the_scene():
    means = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    seen = overview(means)
    at = np.array([pixel(seen, p) for p in means])
    assert ((at > 0) & (at < seen.width)).all()
