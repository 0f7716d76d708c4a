"""The waveform of a pixel: the blended motion of the Gaussians seen there, or what the pictures say."""

import numpy as np
import pytest

from tests.show.view.conftest import DEVIATION
from tg4mm.core.magnification import Magnification
from tg4mm.fit.motion.animate import displacement_at
from tg4mm.show.view.painter import Look, Painter
from tg4mm.show.view.pixel_panel import Measurer, modal_waveform, seen_at
from tg4mm.show.view.scene import open_scene


def on_the_ball(scene):
    """[N] blending weights of the pixel that shows the middle of what moves at 5 Hz."""
    k, camera = scene.strongest(Magnification.of(1.0, (4.0, 6.0))), scene.cameras[0]
    moves = np.abs(scene.motion.displacement[k]).max(axis=1) > 5e-3
    centre = scene.gaussians.means.numpy()[moves].mean(axis=0)
    u, v, depth = camera.K @ (camera.viewmat[:3, :3] @ centre + camera.viewmat[:3, 3])
    return Painter(scene).pixel_weights(
        Look(Magnification.of(0.0)), 0.0, camera, int(u / depth), int(v / depth)
    )


def test_of_two_gaussians_it_is_their_weighted_mean(scene):
    k = scene.strongest()
    order = np.argsort(-np.abs(scene.motion.displacement[k]).sum(axis=1))
    weights = np.zeros(len(scene.weights))
    weights[order[0]], weights[order[7]] = 0.6, 0.2
    found = modal_waveform(scene, weights)
    direction = np.array([float(v.replace("−", "-")) for v in found.along.strip("()").split(", ")])
    for i in (3, 40, 77):
        blended = weights @ displacement_at(scene.motion, found.times[i] * scene.motion.fps) / 0.8
        assert found.displacement[i] == pytest.approx(blended @ direction, abs=1e-4)
    assert np.abs(found.displacement).max() > 5e-3
    np.testing.assert_allclose(found.deviation, DEVIATION, rtol=1e-5)
    np.testing.assert_allclose(
        seen_at(scene, weights), weights @ scene.gaussians.means.numpy() / 0.8, rtol=1e-5
    )
    assert found.frequencies.tolist() == [2.5, 5.0]
    assert found.peak == (scene.motion.freqs_hz[k], found.amplitudes.max())
    assert np.abs(found.displacement).max() == pytest.approx(found.amplitudes.max(), rel=0.3)


def test_background_is_no_place(scene):
    assert seen_at(scene, np.full(len(scene.weights), 1e-6)) is None


def test_a_scene_at_rest_has_none(still_run):
    still = open_scene(still_run)
    assert modal_waveform(still, np.ones(len(still.weights))) is None


def test_the_pictures_say_the_same(scene):
    weights = on_the_ball(scene)
    fitted = modal_waveform(scene, weights)
    measurer = Measurer(scene)
    point = seen_at(scene, weights)
    assert not measurer.is_ready
    measured = measurer.at(point)
    assert measurer.is_ready
    assert measured.peak[0] == pytest.approx(5.0, abs=0.3)
    assert measured.peak[1] == pytest.approx(fitted.peak[1], rel=0.3)
    assert measured.displacement.shape == measured.deviation.shape == (12,)
    assert measured.floor.shape == measured.amplitudes.shape == measured.frequencies.shape


def test_the_ball_around_a_point_is_as_large_as_four_pixels(scene):
    camera = scene.cameras[0]
    point = camera.position + 2.0 * camera.forward
    nearest = min(np.linalg.norm(point - c.position) / c.K[0, 0] for c in scene.cameras)
    assert Measurer(scene).radius(point) == pytest.approx(4 * nearest)
