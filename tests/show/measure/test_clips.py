"""Clips: one answer in x, y, z from series with clocks of their own, with deviations that hold."""

import numpy as np
import pytest

from tests.helpers.synthetic import _viewmats
from tests.show.measure.filmed import BALL_SPHERE, of_parts, run_of, sine
from tg4mm.show.measure import measure, parse_sensor, prepare
from tg4mm.show.measure.clips import KnownPhases, Rows, together, triangulated
from tg4mm.show.measure.locate import sight_axes
from tg4mm.show.measure.series import Series

HZ, FPS, SAMPLES = 4.3, 30.0, 60
PHASOR = np.array([1.0, 0.5j, -0.8 + 0.3j])
THETA = np.array([0.0, 2.0, -1.0, 0.5, 3.0, -2.0])
AXES = [sight_axes(v, np.zeros(3)) for v in _viewmats(6, 0.0)]
NONE = KnownPhases(np.zeros(0), np.zeros((6, 0)))


def clip(c, rng, sigma, phasor=PHASOR, hz=HZ):
    """What clip c shows of the phasor, with white noise, and 30 times as much of it along the sight."""
    times = np.arange(SAMPLES) / FPS
    noise = sigma * np.array([1.0, 1.0, 30.0])
    own = AXES[c] @ phasor * np.exp(1j * THETA[c])
    values = (np.exp(2j * np.pi * hz * times)[:, None] * own).real + noise * rng.normal(size=(SAMPLES, 3))
    spread = np.broadcast_to(noise, (SAMPLES, 3))
    labels = "right", "up", "sight"
    return Series(
        f"clip_{c}", times, values - values.mean(0), spread, spread, AXES[c], labels, None, None,
        np.diag(noise**2), np.ones(3), np.zeros(3), np.zeros(3), np.zeros(3),
    )  # fmt: skip


def found(seed, sigma=0.1, known=NONE, **how):
    rng = np.random.default_rng(seed)
    (own,), phases = together([[clip(c, rng, sigma, **how) for c in range(6)]], known, [0.0])
    return own, phases


def test_a_vibration_has_its_phasor_and_the_clips_their_phases():
    own, phases = found(0)
    (peak,) = own.spectrum.peaks
    assert peak.frequency_hz == pytest.approx(HZ, abs=4 * peak.frequency_deviation_hz)
    assert np.abs(peak.phasor - PHASOR).max() < 0.1
    assert np.abs(np.exp(1j * (phases.radians[:, 0] - THETA)) - 1).max() < 0.15
    at = np.abs(own.spectrum.freqs_hz - HZ).argmin()
    assert own.spectrum.amplitude[at] == pytest.approx(np.abs(PHASOR), rel=0.15)
    assert [len(peaks) for peaks in own.of_clips] == [1] * 6


@pytest.mark.slow
@pytest.mark.parametrize("is_known", [False, True])
def test_deviations_are_the_scatter_over_many_records(is_known):
    known = KnownPhases(np.array([HZ]), THETA[:, None]) if is_known else NONE
    peaks = [found(seed, 0.15, known)[0].spectrum.peaks[0] for seed in range(24)]
    errors = np.array([np.abs(p.phasor) - np.abs(PHASOR) for p in peaks]) / [p.deviation for p in peaks]
    assert 0.8 < errors.std() < 1.2
    assert abs(errors.mean()) < 0.4


def test_what_the_clips_disagree_on_is_in_the_deviation():
    rows, rng = [], np.random.default_rng(3)
    for c in range(6):
        seen = AXES[c][:2] @ PHASOR * np.exp(1j * THETA[c])
        rows.append(Rows(10 * AXES[c][:2], 10 * seen + 5 * (rng.normal(size=2) + 1j * rng.normal(size=2))))
    phasor, variance, _, _ = triangulated([rows], THETA)
    assert np.sqrt(variance[0]).min() > 0.15  # unit noise alone would give some .05
    assert np.abs(phasor[0] - PHASOR).max() < 4 * np.sqrt(variance[0]).max()


def test_noise_alone_makes_no_peak():
    assert not any(found(seed, phasor=np.zeros(3))[0].spectrum.peaks for seed in range(20))


def test_a_direction_that_no_clip_shows_is_not_observed():
    rng = np.random.default_rng(0)
    clips = [clip(0, rng, 0.1) for _ in range(2)]
    spread = np.where([True, True, False], clips[0].noise, np.inf)
    blind = [
        Series(
            c.clock, c.times_s, c.displacement * [1, 1, 0], spread, spread, c.axes, c.labels, None, None,
            np.diag([0.01, 0.01, np.inf]), *np.ones((1, 3)), *np.zeros((3, 3)),
        )
        for c in clips
    ]  # fmt: skip
    ((own,), _) = together([blind], KnownPhases(np.zeros(0), np.zeros((2, 0))), [0.0])
    sight = np.abs(AXES[0][2])
    assert np.isinf(own.spectrum.floor[0][sight.argmax()])


def test_pictures_of_clips_tell_amplitude_and_phase_in_three_directions(tmp_path):
    along, starts = np.array([0.016, -0.008, 0.012]), [0.0, 0.31, 0.17, 0.45, 0.08, 0.23]
    clips = {"n_timesteps": 36, "kind": "clips", "noise": 0.004, "starts": starts}
    run = run_of(tmp_path, of_parts(ball=sine(HZ, along, 0.4)), **clips)
    scene = prepare(run, keep=False)
    result = measure(scene, [parse_sensor(BALL_SPHERE)])
    ball = result["ball"]
    peak = ball.spectrum.peaks[0]
    assert ball.labels == ("x", "y", "z")
    assert any("clocks are independent" in note for note in result.notes)
    assert [s.labels for s in ball.clips] == [("right", "up", "sight")] * 6
    assert peak.frequency_hz == pytest.approx(HZ, abs=0.03)
    assert np.abs(peak.phasor - along * np.exp(0.4j)).max() < 0.1 * np.abs(along).max()
    assert (np.abs(peak.phasor - along * np.exp(0.4j)) < 3.5 * peak.deviation).all()
    turns = 2 * np.pi * HZ * np.array(starts)
    assert np.abs(np.exp(1j * (result.clip_phases.radians[:, 0] - turns)) - 1).max() < 0.2
