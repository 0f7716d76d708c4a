"""When two poses are the same, and how much of a motion is seen."""

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset, with_phasors
from tg4mm.capture import load_capture
from tg4mm.core.magnification import Magnification
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.scores import ScoredMotion, change_figures, closure

FPS, T = 30.0, 30


def method(modes, band=None, rotation=0):
    shape = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 3.0]])
    displacement = np.stack([m * shape for m in modes.values()]).astype(np.complex64)
    motion = ModalMotion.of_phasors(np.array(list(modes)), displacement, rotation * displacement, FPS, T)
    return ScoredMotion("ours", motion, Magnification.of(1.0, *([band] if band else [])))


def displacement(m, t, alpha):
    gain = 1 + alpha * (m.magnified.inside(m.motion.freqs_hz) & (m.motion.freqs_hz > 0))  # 0 Hz stands still
    phase = gain * np.exp(2j * np.pi * m.motion.freqs_hz * t / FPS)
    return np.einsum("k,knc->nc", phase, m.motion.displacement).real


@pytest.mark.parametrize(
    "m",
    [
        method({3.0: -1j}),
        method({3.0: 1.0}),
        method({3.0: 0.6 + 0.8j}),
        method({3.0: -1j, 5.0: 1 + 1j}, band=(2, 4)),
        method({0.0: 1.0, 7.0: 0.0}),
    ],
)
def test_keys_are_equal_exactly_when_poses_are(m):
    moments = [(t, alpha) for t in range(T) for alpha in (0.0, 5.0)]
    poses = [displacement(m, *moment) for moment in moments]
    keys = [m.state(*moment) for moment in moments]
    for i, a in enumerate(poses):
        for j, b in enumerate(poses):
            assert (keys[i] == keys[j]) == np.allclose(a, b, atol=1e-6), (moments[i], moments[j])


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    root = tmp_path_factory.mktemp("change") / "posts_3Hz_0_02"
    made = make_synthetic_dataset(root, n_views=3, n_timesteps=10, size=40, n_test=2, alphas=())
    return load_capture(root, split="test"), *made


def figures(scene, motion, alpha=0.0):
    capture, gaussians, exact = scene
    return change_figures(
        gaussians, ScoredMotion("ours", motion), ScoredMotion("ceiling", exact), capture, alpha
    )


def test_the_exact_motion_changes_the_picture_as_the_ceiling_does(scene):
    found = figures(scene, scene[2], alpha=5.0)
    assert found["change_gain"] == pytest.approx(1)
    assert found["change_residual"] == pytest.approx(0, abs=1e-6)


def test_a_motion_a_quarter_of_a_period_late_is_beside_it(scene):
    motion = scene[2]
    late = with_phasors(
        motion, displacement=np.complex64(1j) * motion.displacement, rotation=1j * motion.rotation
    )
    found = figures(scene, late)
    assert found["change_gain"] == pytest.approx(0, abs=0.15)
    assert found["change_residual"] == pytest.approx(1, abs=0.15)


def test_closure_is_where_ssim_lies_between_nothing_and_the_ceiling():
    assert closure(0.95, 0.9, 1.0) == pytest.approx(0.5)
    assert closure(0.85, 0.9, 1.0) == pytest.approx(-0.5)
    assert closure(0.9, 0.9, 0.9) is None
