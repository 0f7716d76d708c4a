"""Sensors on clips, each with a clock of its own, and before a camera that moves."""

from dataclasses import replace

import numpy as np
import pytest

from tests.show.measure.filmed import BALL_SPHERE, of_parts, run_of, sine
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.nuisance.projection import COLUMNS, EXPOSURE
from tg4mm.show.measure import measure, measure_one, parse_sensor, prepare
from tg4mm.show.measure.residuals import pull_back, shown_fields
from tg4mm.show.measure.sides import HALVES, Sides

AMPLITUDE = np.array([0.016, 0.0, 0.012])


def test_a_moving_camera_shows_what_moves_before_it(tmp_path):
    run = run_of(tmp_path, of_parts(ball=sine(9.0, AMPLITUDE)), n_timesteps=40, walks=True, noise=0.004)
    scene = prepare(run)
    found = measure(scene, [parse_sensor(BALL_SPHERE)])
    ball = found["ball"]
    assert ball.labels == ("x", "y", "z")
    assert ball.spectrum.peaks[0].frequency_hz == pytest.approx(9.0, abs=0.1)
    assert any("the camera moves" in note for note in found.notes)
    again = measure(prepare(run), [parse_sensor(BALL_SPHERE)])["ball"]  # from what was kept
    assert again.displacement == pytest.approx(ball.displacement, rel=1e-6, abs=1e-9)


def test_sensors_read_from_the_pictures_what_is_pulled_back_to_gaussians(tmp_path):
    run = run_of(tmp_path, of_parts(ball=sine(5.0, AMPLITUDE)), n_views=2, n_timesteps=24, noise=0.004)
    scene = prepare(run, keep=False)
    exposed = [
        replace(v, nuisance=v.nuisance.with_active(np.arange(COLUMNS) < EXPOSURE.stop)) for v in scene.views
    ]
    pictures = scene.observations
    sides = np.zeros((HALVES, len(scene.clocks[0].times_s), len(scene.means), DOF), np.float32)
    for view in exposed:
        shown = shown_fields(view.view, scene.modal.fields)
        pull_back(pictures, view, shown, scene.clocks[0].series, sides, lambda _: None)
    found = []
    for own in (Sides.of(sides), None):
        clocks = tuple(replace(clock, sides=own) for clock in scene.clocks)
        asked = replace(scene, views=exposed, clocks=clocks), parse_sensor(BALL_SPHERE)
        found.append(measure_one(*asked).series)
    error = np.abs(found[0].displacement - found[1].displacement) / found[1].deviation
    assert np.sqrt((error**2).mean()) < 0.03  # what is kept of Gaussians is rounded to a byte
    assert np.ptp(found[1].displacement) > 20 * found[1].deviation.min()
