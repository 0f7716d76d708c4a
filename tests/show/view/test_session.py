"""Pictures of the scene as `tg4mm render` writes them, playing time, the browser's camera, a chart."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.motion_animate import alphas
from tg4mm.capture.pictures import FilePictures
from tg4mm.core.colour import amount_colours
from tg4mm.core.magnification import Magnification
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.fit.motion.animate import animate
from tg4mm.run import Run
from tg4mm.show.maps import middle_depth
from tg4mm.show.render.cameras import Camera, look_at
from tg4mm.show.render.image import render_image
from tg4mm.show.view.charts import waveform_chart
from tg4mm.show.view.colours import Colour, choices, gaussian_colours, legend
from tg4mm.show.view.scene import camera_of, open_scene, standpoint_of
from tg4mm.show.view.screen import Pace, Screen, Viewport, picture_of
from tg4mm.show.view.session import DisplaySettings, PlaybackClock, SceneRenderer, Session

CANVAS = Viewport((0.0, -4.0, 0.5), (0.7071068, -0.7071068, 0.0, 0.0), 0.7, 320, 240)


@pytest.fixture(scope="module")
def painter(scene):
    return SceneRenderer(scene)


@pytest.mark.parametrize(("alpha", "band"), [(0.0, None), (20.0, None), (20.0, (4.0, 6.0))])
def test_the_picture_is_the_one_that_render_writes(scene, painter, alpha, band):
    camera, t = scene.cameras[1], 3.5
    gaussians = animate(scene.gaussians, scene.motion, t, alphas(scene.motion, alpha, band))
    wanted = to_bytes(render_image(gaussians, camera.viewmat, camera.K, camera.width, camera.height))
    shown = painter.paint(
        DisplaySettings(Magnification.of(alpha, *([band] if band else []))), t / scene.motion.fps, camera
    )
    assert np.abs(shown.astype(int) - wanted).max() <= 1


def test_colours_are_those_of_the_band_s_strongest_frequency(scene):
    moving = [
        gaussian_colours(scene, Colour.amplitude, Magnification.of(1.0, band))
        for band in ((2.0, 3.0), (4.0, 6.0))
    ]
    dark = amount_colours(np.array(0.0))
    shown = [(np.abs(colours - dark).max(axis=1) > 0.1) for colours in moving]
    assert shown[0].any()
    assert shown[1].any()
    assert not (shown[0] & shown[1]).any()  # the post alone, the ball alone


def test_a_band_without_frequencies_shows_colours_as_filmed_and_says_so(scene):
    assert gaussian_colours(scene, Colour.phase, Magnification.of(1.0, (9.0, 10.0))) is None
    assert "No frequency" in legend(scene, Colour.phase, Magnification.of(1.0, (9.0, 10.0)))
    assert "2.5 Hz" in legend(scene, Colour.amplitude, Magnification.of(1.0, (2.0, 3.0)))


def test_a_run_without_motion_has_no_colours_but_its_own(still_run):
    still = open_scene(still_run)
    assert choices(still) == (Colour.picture,)
    assert still.duration == 0
    assert len(still.notes) == 2
    assert "no motion" in still.notes[0]
    assert "No cameras of the capture" in still.notes[1]
    camera = still.cameras[0]
    assert (
        SceneRenderer(still).paint(DisplaySettings(Magnification.of(50.0)), 0.0, camera).min() < 200
    )  # the overview has the scene in view


def test_weights_of_a_pixel_sum_to_its_opacity_and_name_who_is_there(scene, painter):
    camera, k = scene.cameras[0], scene.strongest(Magnification.of(1.0, (4.0, 6.0)))
    moves = np.abs(scene.motion.displacement[k]).max(axis=1) > 1e-4
    centre = scene.gaussians.means.numpy()[moves].mean(axis=0)
    seen = camera.K @ (camera.viewmat[:3, :3] @ centre + camera.viewmat[:3, 3])
    x, y = (int(v) for v in seen[:2] / seen[2])
    weights = painter.pixel_weights(DisplaySettings(Magnification.of(0.0)), 0.0, camera, x, y)
    assert 0.9 < weights.sum() <= 1 + 1e-6
    assert weights[moves].sum() > 0.9 * weights.sum()
    corner = painter.pixel_weights(DisplaySettings(Magnification.of(0.0)), 0.0, camera, 0, 0)
    assert corner.sum() < 0.05


@pytest.fixture
def sent():
    return []


@pytest.fixture
def session(scene):
    return Session(scene, DisplaySettings(Magnification.of(20.0)), PlaybackClock(scene.duration))


@pytest.fixture
def screen(session, sent):
    screen = Screen(session, lambda picture, quality: sent.append((picture, quality)))
    screen._pace = Pace(pixels=100.0 * 100)  # as on a slow machine
    return screen


def test_every_change_is_shown(screen, session, sent):
    screen.refresh(CANVAS, 0.0)
    screen.refresh(CANVAS, 0.0)
    session.magnify(-1.0)
    assert session.changed.is_set()
    assert screen.refresh(CANVAS, 0.0)
    session.set_clock(lambda clock, now: clock.sought(now, 0.1))
    assert screen.refresh(CANVAS, 0.0)
    moved = Viewport((0.0, -3.0, 0.5), CANVAS.wxyz, CANVAS.fov, 320, 240)
    assert screen.refresh(moved, 0.0)
    assert len({picture.tobytes() for picture, _ in sent}) >= 3  # α = −1 looks alike at any moment


def test_a_run_without_frequencies_is_shown_and_says_so(run, tmp_path, sent):
    made = Run.create(tmp_path / "run", run.dataset, "modal", {})
    made.save_space(run.load_space(), {})
    made.save_motion(run.load_motion().selected(np.zeros(2, bool)), {})
    opened = open_scene(made)
    assert opened.notes == ("No frequency was found in this run: there is nothing to magnify.",)
    assert opened.duration == 0
    assert opened.alpha_to_see() == 0
    session = Session(
        opened, DisplaySettings(Magnification.of(20.0)), PlaybackClock(opened.duration, playing=True)
    )
    screen = Screen(session, lambda picture, quality: sent.append(picture))
    assert screen.refresh(CANVAS, 0.0)
    assert sent[0].min() < 200


@pytest.mark.parametrize("zoom", [1, 2])
def test_beside_the_magnified_one_is_the_films_own_picture_where_a_camera_filmed(scene, painter, zoom):
    camera, half = scene.cameras[2], np.diag([zoom, zoom, 1.0])
    wide = replace(camera, K=half @ camera.K, width=zoom * camera.width, height=zoom * camera.height)
    seen = scene.filmed.seen_by(wide, 3 / scene.motion.fps)
    taken = scene.filmed._capture
    (row,) = np.flatnonzero(
        (taken.timesteps == 3) & (np.abs(taken.viewmats - camera.viewmat).max((1, 2)) < 1e-9)
    )
    own = to_bytes(FilePictures(taken).rgb(row)).astype(int)
    coarse = seen.reshape(camera.height, zoom, camera.width, zoom, 3).mean((1, 3))
    assert np.abs(coarse - own)[1:-1, 1:-1].mean() < (0.5 if zoom == 1 else 4)
    away = camera.viewmat.copy()
    away[0, 3] += 0.3
    assert scene.filmed.seen_by(replace(camera, viewmat=away), 0.1) is None
    canvas = Viewport((5.0, 5.0, 5.0), (1.0, 0, 0, 0), 0.6, 900, 300)
    beside = picture_of(
        painter, DisplaySettings(Magnification.of(20.0), beside=True), 0.1, canvas, (900, 300)
    )
    assert beside.shape == (300, 900, 3)
    assert (beside[:20, :120] == 0).any(), "which of the two it is is written"


def test_a_waveform_goes_up_where_its_values_do():
    values = np.array([0.0, 1.0, -1.0])
    svg = str(waveform_chart(np.array([0.0, 1.0, 2.0]), values, "mm", np.full(3, 0.1)))
    points = re.search(r'class="curve" points="([^"]+)"', svg)[1].split()
    y = [float(p.split(",")[1]) for p in points]
    assert y[1] < y[0] < y[2]
    assert 'class="spread"' in svg
    ET.fromstring(svg)


def test_without_loop_it_stays_at_the_end_and_plays_again_from_the_start():
    clock = PlaybackClock(2.0, since=100.0, playing=True, loop=False)
    assert clock.at(110.0) == 2.0
    assert not clock.running(110.0)
    again = clock.changed(110.0, playing=True)
    assert again.at(110.5) == pytest.approx(0.5)


def test_a_pause_holds_the_moment():
    clock = PlaybackClock(2.0, since=0.0, playing=True).changed(0.7, playing=False)
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
