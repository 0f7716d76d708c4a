"""Samples at uneven times are brought to an even clock; long gaps are reported."""

import numpy as np
import pytest

from tg4mm.core.even_clock import is_filled, on_even_clock, unrounded

RATE = 60.0


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_tone_under_a_third_of_the_rate_stays_what_it_is(jitter):
    """Two frames of 240 lack, one of them beside a third; the others come early or late."""
    rng = np.random.default_rng(1)
    times = (np.delete(np.arange(240), [77, 163, 164]) + jitter * rng.uniform(-1, 1, 237)) / RATE
    for hz, least in ((2.0, 1e-3), (11.4, 0.03)):  # across two frames that lack a fast tone is a guess
        even, found = on_even_clock(times, np.sin(2 * np.pi * hz * times))
        assert len(even) == 240
        assert np.ptp(np.diff(even)) < 1e-9
        truth = np.sin(2 * np.pi * hz * even)
        assert np.sqrt(((found - truth)[2:-2] ** 2).mean()) < least
    assert is_filled(times)


def test_even_samples_stay_bit_for_bit_though_times_are_rounded():
    times = np.round(np.arange(50) / 30, 3)
    values = np.random.default_rng(0).normal(size=(50, 2))
    even, found = on_even_clock(times, values)
    assert found is values
    np.testing.assert_allclose(even, times, atol=1e-3)


def test_a_gap_of_four_frames_is_too_long():
    assert not is_filled(np.delete(np.arange(50), [20, 21, 22]) / RATE)
    assert is_filled(np.delete(np.arange(50), [20, 21]) / RATE)


@pytest.mark.parametrize("decimals", [2, 3, 4])
@pytest.mark.parametrize("rate", [20, 30, 60, 100])
def test_a_sample_that_lacks_is_not_taken_for_rounding(rate, decimals):
    whole = np.round(np.arange(500) / rate, decimals)
    even = unrounded(whole)
    assert even is None or np.abs(even - np.arange(500) / rate).max() <= 0.51 * 10.0**-decimals
    times = np.delete(whole, 250)
    assert unrounded(times) is None
    if 2 * rate < 10**decimals:  # else the gap itself hardly shows
        assert len(on_even_clock(times, times)[0]) == 500
