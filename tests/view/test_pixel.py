"""The waveform of a pixel is the blended motion of the Gaussians seen there."""

import numpy as np
import pytest

from tests.view.conftest import DEVIATION
from tg4mm.motion.animate import displacement_at
from tg4mm.view.pixel import modal_waveform
from tg4mm.view.scene import open_scene


def test_of_two_gaussians_it_is_their_weighted_mean(scene):
    k = scene.strongest(None)
    order = np.argsort(-np.abs(scene.motion.displacement[k]).sum(axis=1))
    weights = np.zeros(len(scene.weights))
    weights[order[0]], weights[order[7]] = 0.6, 0.2
    found = modal_waveform(scene, weights)
    for i in (3, 40, 77):
        blended = weights @ displacement_at(scene.motion, found.times[i] * scene.motion.fps) / 0.8
        assert found.displacement[i] == pytest.approx(blended @ found.direction, abs=1e-9)
    np.testing.assert_allclose(found.deviation, DEVIATION, rtol=1e-5)
    np.testing.assert_allclose(found.point, weights @ scene.gaussians.means.numpy() / 0.8, rtol=1e-5)
    assert found.frequencies.tolist() == [2.5, 5.0]
    assert found.frequencies[found.amplitudes.argmax()] == scene.motion.freqs_hz[k]
    assert np.abs(found.displacement).max() == pytest.approx(found.amplitudes.max(), rel=0.3)


def test_background_has_none(scene):
    assert modal_waveform(scene, np.full(len(scene.weights), 1e-6)) is None


def test_a_scene_at_rest_has_none(still_run):
    still = open_scene(still_run)
    assert modal_waveform(still, np.ones(len(still.weights))) is None
