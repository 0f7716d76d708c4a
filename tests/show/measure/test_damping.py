"""Damping by half-power bandwidth: of an oscillator that noise drives, and of nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from tg4mm.capture.codec import Loss
from tg4mm.show.measure.damping import HALF_POWER, Damping, damping_of, half_power, with_loss
from tg4mm.show.measure.spectrum import spectrum_of

FPS, HZ = 30.0, 4.0


def driven(ratio, n, seed):
    """Times [n] and values of an oscillator of that damping ratio under white noise, its exact recursion; 5 % noise."""
    rng, steps = np.random.default_rng(seed), 20
    omega, dt, settling = 2 * np.pi * HZ, 1 / FPS / 20, 600
    a, c = np.exp(-ratio * omega * dt), np.cos(omega * np.sqrt(1 - ratio**2) * dt)
    drive = rng.normal(size=(n + settling) * steps)
    values = lfilter([1], [1, -2 * a * c, a * a], drive)[settling * steps :: steps]
    return np.arange(n) / FPS, values / values.std() + 0.05 * rng.normal(size=n)


@pytest.mark.parametrize("ratio", [0.02, 0.05])
def test_a_driven_oscillator_has_its_damping(ratio):
    found = [half_power(*driven(ratio, 3000, seed), HZ) for seed in range(8)]
    assert all(d is not None and d.method == "half-power bandwidth" for d in found)
    ratios = np.array([d.ratio for d in found if d is not None])
    deviations = np.array([d.deviation for d in found if d is not None])
    assert ratios.mean() == pytest.approx(ratio, rel=0.12)
    assert (np.abs(ratios - ratio) < 2 * deviations).mean() > 0.7
    assert deviations.mean() < 0.4 * ratio
    assert found[0].decay_per_s == pytest.approx(2 * np.pi * HZ * found[0].ratio, rel=0.1)


def test_a_steady_tone_has_none():
    times = np.arange(3000) / FPS
    noise = 0.05 * np.random.default_rng(0).normal(size=3000)
    assert half_power(times, np.sin(2 * np.pi * 4.03 * times) + noise, 4.03) is None


def test_a_record_too_short_to_resolve_the_peak_has_none():
    assert half_power(*driven(0.01, 300, 0), HZ) is None


def test_noise_alone_has_none():
    times = np.arange(3000) / FPS
    found = [half_power(times, np.random.default_rng(s).normal(size=3000), HZ) for s in range(10)]
    assert sum(d is not None for d in found) <= 1


@pytest.mark.parametrize("ratio", [0.02, 0.10])
def test_what_is_over_early_in_the_record_has_the_right_one(ratio):
    times, hz = np.arange(300) / FPS, 10.0
    values = np.exp(-ratio * 2 * np.pi * hz * times) * np.cos(2 * np.pi * hz * times)
    displacement = values[:, None] * np.array([1.0, 0, 0])
    noise = np.full((300, 3), 1e-6)
    known = {"noise": noise, "is_resolved": np.ones(3, bool)}
    series = SimpleNamespace(times_s=times, displacement=displacement, **known)
    found = damping_of(series, spectrum_of(times, displacement, noise).peaks[0])
    assert found.ratio == pytest.approx(ratio / np.hypot(1, ratio), rel=0.001)


def test_what_a_codec_adds_to_a_decay_is_taken_off_and_its_error_is_in_the_deviation():
    ringing = Damping(0.012, 0.0003, 0.6)
    corrected = with_loss(ringing, Loss(0.97, 0.05, faster=0.1, faster_deviation=0.04))
    assert (corrected.ratio, corrected.decay_per_s) == pytest.approx((0.010, 0.5))
    assert corrected.deviation == pytest.approx(np.hypot(0.0003, 0.0008))
    assert with_loss(ringing, Loss(1.0, 0.0)) == ringing
    assert with_loss(ringing, Loss(float("nan"), float("nan"), "not known")) == ringing
    assert with_loss(ringing, Loss(0.3, 0.05, "smaller")) is None
    driven = Damping(0.012, 0.0003, 0.6, HALF_POWER)
    assert with_loss(driven, Loss(0.97, 0.05)) == driven
    assert with_loss(None, Loss(0.97, 0.05)) is None
