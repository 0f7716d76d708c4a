"""Exposure, white balance and flicker: how far, how slowly, and never brighter than without."""

import numpy as np
import pytest

from dataset_gen.effects.record import drift_gains, flicker_gains, slow_curve


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("seed", range(5))
def test_exposure_drifts_by_the_stated_percent_peak_to_peak(seed):
    gains = drift_gains(5.0, 90, 30.0, rng(seed))
    assert gains.shape == (90, 3)
    assert np.ptp(gains[:, 1]) == pytest.approx(0.05)
    assert gains.max() <= 1.0
    assert gains[:, 1].max() == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_white_balance_drifts_by_a_third_of_it(seed):
    gains = drift_gains(6.0, 90, 30.0, rng(seed))
    for channel in (0, 2):
        assert np.ptp(gains[:, channel] / gains[:, 1]) == pytest.approx(0.02)
    assert np.abs(np.corrcoef((gains[:, [0, 2]] / gains[:, 1:2]).T)[0, 1]) < 1 - 1e-6


@pytest.mark.parametrize(("n", "fps"), [(30, 30.0), (300, 30.0), (1000, 240.0)])
def test_the_drift_is_slow(n, fps):
    curve = np.array([slow_curve(n, fps, rng(seed)) for seed in range(8)])
    assert curve.min() == 0.0
    assert curve.max() == pytest.approx(1.0)
    # Of a sum of tones up to F the slope is 2π F times the size at most; sizes add up to three at most.
    fastest = min(1.5 * fps / n, 1.0)
    assert np.abs(np.diff(curve, axis=1)).max() * fps < 2 * np.pi * fastest * 1.5
    spectrum = np.abs(np.fft.rfft(curve - curve.mean(1, keepdims=True), axis=1)) ** 2
    f = np.fft.rfftfreq(n, 1 / fps)
    if n == 300:
        assert spectrum[:, f > 2.0].sum() < 0.02 * spectrum.sum()


def test_flicker_is_mains_light_sampled_by_the_frame_rate():
    times = np.arange(120) / 30.0
    gains = flicker_gains(2.0, 100.0, times, 0.4)
    assert gains.max() <= 1.0
    assert gains.min() >= 0.98
    spectrum = np.abs(np.fft.rfft(gains - gains.mean()))
    assert np.fft.rfftfreq(120, 1 / 30.0)[spectrum.argmax()] == pytest.approx(10.0)  # 100 Hz aliased at 30
    np.testing.assert_allclose(
        flicker_gains(2.0, 100.0, np.arange(120) / 25.0, 0.4), gains[0]
    )  # 100 = 4 · 25
