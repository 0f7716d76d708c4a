"""A tone in a band that is given: right on average, and off by what its ± says, over random records of few periods."""

import numpy as np
import pytest

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.lines.band import tone_in


def record(rng, n, fps, band, drift, noise):
    """A tone of amplitude 1 anywhere in the band, a slower one of rms `drift` at random, white noise."""
    t, hz, slow = np.arange(n) / fps, rng.uniform(*band), rng.uniform(0, band[0])
    phase, other = rng.uniform(0, 2 * np.pi, 2)
    y = np.cos(2 * np.pi * hz * t + phase) + noise * rng.normal(size=n)
    return t, y + drift * np.sqrt(rng.exponential()) * np.cos(2 * np.pi * slow * t + other), hz, phase


@pytest.mark.parametrize(
    ("n", "fps", "band"),
    [(30, 30, (0.8, 1.2)), (15, 15, (0.5, 1.5)), (60, 30, (0.1, 1.1)), (90, 30, (3.0, 4.0))],
)
@pytest.mark.parametrize(("drift", "noise"), [(0.0, 0.02), (0.3, 0.3), (1.0, 0.1)])
def test_amplitudes_and_frequencies_are_off_by_what_is_said(n, fps, band, drift, noise):
    rng = np.random.default_rng(0)
    off, hz_off, found, beside = [], [], [], []
    for _ in range(60):
        t, y, hz, phase = record(rng, n, fps, band, drift, noise)
        tone = tone_in(y, t, band, noise)
        off.append((abs(tone.phasor[0]) - 1) / tone.amplitude_deviation[0])
        hz_off.append((tone.hz - hz) / tone.hz_deviation)
        found.append(abs(tone.phasor[0]))
        middle = t.mean()
        beside.append(np.angle(tone.phasor[0] * np.exp(2j * np.pi * (tone.hz - hz) * middle - 1j * phase)))
    assert np.mean(found) == pytest.approx(1, abs=0.1)
    assert np.mean(np.abs(off) < 1) > 0.6
    assert np.mean(np.abs(off) < 2) > 0.85
    assert np.mean(np.abs(hz_off) < 2) > 0.85
    assert np.median(np.abs(beside)) < 0.3


def test_one_period_is_resolved_less_than_many():
    rng = np.random.default_rng(1)
    sure = []
    for n in (30, 90, 300):
        t, y, _, _ = record(rng, n, 30, (0.8, 1.2), 0.0, 0.02)
        sure.append(tone_in(y, t, (0.8, 1.2), 0.02).amplitude_deviation[0])
    assert sure[0] > 0.15
    assert sure[0] > sure[1] > sure[2]


def test_components_share_a_frequency_and_a_still_one_is_zero():
    t = np.arange(40) / 20
    y = np.stack([np.cos(2 * np.pi * t), 2 * np.sin(2 * np.pi * t), np.zeros(40)], 1)
    tone = tone_in(y, t, (0.7, 1.3))
    assert np.abs(tone.phasor) == pytest.approx([1, 2, 0], abs=0.1)
    assert tone.hz == pytest.approx(1, abs=0.05)


def test_records_that_tell_nothing_are_refused():
    with pytest.raises(Tg4mmError, match="5 samples are too few for an estimate at 1 to 2 Hz"):
        tone_in(np.zeros(5), np.arange(5) / 10, (1, 2))
    with pytest.raises(Tg4mmError, match="9 Hz is not below half the rate of 10 Hz"):
        tone_in(np.zeros(20), np.arange(20) / 10, (1, 9))


def test_a_long_record_is_averaged_where_the_band_allows_it():
    t = np.arange(9000) / 300
    tone = tone_in(np.cos(2 * np.pi * 0.03 * t), t, (0.02, 0.05), 1e-3)
    assert abs(tone.phasor[0]) == pytest.approx(1, abs=4 * tone.amplitude_deviation[0])
