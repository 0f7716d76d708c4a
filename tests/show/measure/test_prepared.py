"""The pass through the pictures: what is kept of it, and a camera that moves."""

import numpy as np
import pytest

from tests.show.measure.filmed import BALL_SPHERE, of_parts, run_of, sine
from tg4mm.show.measure import measure, parse_sensor, prepare
from tg4mm.show.measure.stored_pass import RightHandSides

AMPLITUDE = np.array([0.016, 0.0, 0.012])
N, FRAMES = 400, 60
SEEN = np.arange(50, 350)


def test_a_moving_camera_shows_what_moves_before_it(tmp_path):
    run = run_of(tmp_path, of_parts(ball=sine(9.0, AMPLITUDE)), n_timesteps=40, walks=True, noise=0.004)
    scene = prepare(run)
    found = measure(scene, [parse_sensor(BALL_SPHERE), parse_sensor("all")])
    ball = found["ball"]
    assert not found[
        "all"
    ].relation.phases  # all of the scene moves as the camera does: its motion is not observed
    assert ball.labels == ("x", "y", "z")
    assert ball.spectrum.peaks[0].frequency_hz == pytest.approx(9.0, abs=0.1)
    assert any("moving camera" in note for note in found.notes)
    again = measure(prepare(run), [parse_sensor(BALL_SPHERE)])["ball"]  # from what was kept
    assert again.displacement == pytest.approx(ball.displacement, rel=1e-6, abs=1e-9)


@pytest.fixture
def exact():
    """Noise of very different sizes from Gaussian to Gaussian; a quarter of them is not seen."""
    rng = np.random.default_rng(0)
    out = np.zeros((2, FRAMES, N, 6), np.float32)
    sizes = 10 ** rng.uniform(-3, 3, size=(len(SEEN), 6))
    out[:, :, SEEN] = rng.normal(size=(2, FRAMES, len(SEEN), 6)) * sizes
    return out


def motions(rows):
    out = np.zeros((6, N, 6), np.float32)
    out[:, rows] = np.random.default_rng(1).normal(size=(6, len(rows), 6))
    return out


@pytest.mark.parametrize("rows", [np.arange(60, 65), np.arange(0, 200), np.arange(N)])
def test_rounding_adds_a_ten_thousandth_of_the_variance(exact, rows):
    e = motions(rows)
    expected = np.einsum("knc,hfnc->hfk", e.astype(float), exact)
    error = RightHandSides.of(exact).summed(e, rows) - expected
    assert 0 < (error**2).mean() < 2e-4 * (expected**2).mean()
