"""What is read off the model is what was put in."""

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import Magnification
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.maps import image_motion, leading_modes, motion_maps, strongest, uncertainty_map
from tg4mm.show.render.cameras import capture_cameras
from tg4mm.show.weights import blending_weights


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


def test_motion_along_the_view_is_not_seen_in_the_picture(tmp_path):
    gaussians, _ = make_synthetic_dataset(tmp_path, n_views=1, n_timesteps=1, size=32, n_test=0)
    camera = capture_cameras(load_capture(tmp_path))[0]
    towards = gaussians.means.numpy() - camera.position
    weights = np.ones(len(gaussians))
    assert image_motion(gaussians, towards, weights, camera) < 1e-3
    across = np.tile(camera.viewmat[0, :3] * 0.01, (len(gaussians), 1))
    depth = (towards @ camera.forward).mean()
    expected = camera.K[0, 0] * 0.01 / depth
    assert image_motion(gaussians, across, weights, camera) == pytest.approx(expected, rel=0.1)
