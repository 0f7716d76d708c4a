"""Sensors on clips, each with a clock of its own, and before a camera that moves."""

import numpy as np
import pytest

from tests.show.measure.filmed import BALL_SPHERE, of_parts, run_of, sine
from tg4mm.show.measure import measure, parse_sensor, prepare

AMPLITUDE = np.array([0.016, 0.0, 0.012])


def test_a_moving_camera_shows_what_moves_before_it(tmp_path):
    run = run_of(tmp_path, of_parts(ball=sine(9.0, AMPLITUDE)), n_timesteps=40, walks=True, noise=0.004)
    scene = prepare(run)
    found = measure(scene, [parse_sensor(BALL_SPHERE)])
    ball = found["ball"]
    assert ball.labels == ("x", "y", "z")
    assert ball.spectrum.peaks[0].frequency_hz == pytest.approx(9.0, abs=0.1)
    assert any("moving camera" in note for note in found.notes)
    again = measure(prepare(run), [parse_sensor(BALL_SPHERE)])["ball"]  # from what was kept
    assert again.displacement == pytest.approx(ball.displacement, rel=1e-6, abs=1e-9)
