"""Sinusoids between the bins, and drifts, are found in functions of time; noise and whole periods have none."""

import numpy as np
import pytest

from tg4mm.fit.motion.spectrum import Clock, find_sinusoids


def functions(n_timesteps, cycles, drift=0.0, noise=0.0, seed=0, n_pixels=400, decay=0.0):
    """[R, T]: principal functions of time of many pixels that swing with every tone, by their strength.

    `drift`: rms of what a pixel drifts over the capture; `noise`: standard deviation; `decay`: cycles to 1/e.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(n_timesteps) / n_timesteps
    video = drift * np.outer(t, rng.normal(size=n_pixels)) + noise * rng.normal(size=(n_timesteps, n_pixels))
    for c in cycles:
        law = np.exp(-t * c / decay) if decay else 1
        for wave in (np.sin, np.cos):
            video += np.outer(wave(2 * np.pi * c * t) * law, rng.normal(size=n_pixels))
    left, strength, _ = np.linalg.svd(video - video.mean(0), full_matrices=False)
    return (left * strength)[:, : min(16, int((strength > 1e-6 * strength[0]).sum()))].T


class TestFrequencies:
    @pytest.mark.parametrize(
        ("n_timesteps", "cycles"),
        [
            (30, (2.5,)),
            (37, (2.5 * 37 / 30,)),
            (30, (1.4,)),
            (12, (3.3,)),
            (30, (5.3, 11.3)),
            (60, (4.5, 5.7, 20.2)),
            (300, (25.4, 113.1)),
            (31, (13.6,)),  # 0.9 of half the frame rate
        ],
    )
    @pytest.mark.parametrize("drift", [0.0, 1.0])
    def test_of_clean_motion_they_are_exact(self, n_timesteps, cycles, drift):
        found = find_sinusoids(functions(n_timesteps, cycles, drift))
        np.testing.assert_allclose(found.cycles, cycles, atol=2e-3 if drift else 1e-4)
        assert found.trend == bool(drift)

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("cycles", [(2.5,), (5.3, 11.3)])
    def test_of_noisy_motion_they_are_as_near_as_noise_lets(self, cycles, seed):
        """Four standard deviations of the Cramér–Rao bound, √(6 σ² / (π² T Σ a² / 2)) … in cycles per capture."""
        noise, n_timesteps, n_pixels = 0.3, 30, 400
        found = find_sinusoids(functions(n_timesteps, cycles, noise=noise, seed=seed, n_pixels=n_pixels))
        bound = np.sqrt(6 * noise**2 / (np.pi**2 * n_timesteps * 2 * n_pixels))  # Σ a² = 2 for each pixel
        np.testing.assert_allclose(found.cycles, cycles, atol=4 * bound)
        assert not found.trend


@pytest.mark.parametrize("jitter", [0.0, 0.2])
@pytest.mark.parametrize("cycles", [(2.5,), (5.3, 41.3)])
def test_of_frames_that_lack_or_come_late_they_are_exact(cycles, jitter):
    """Seven of 100 frames are missing; the others come up to a fifth of a frame early or late."""
    rng = np.random.default_rng(3)
    times = np.delete(np.arange(100), [9, 10, 11, 40, 77, 78, 90]) + jitter * rng.uniform(-1, 1, 93)
    times -= times[0]
    angles = 2 * np.pi * np.outer(cycles, times / 100)
    series = rng.normal(size=(5, 2 * len(cycles))) @ np.concatenate([np.cos(angles), np.sin(angles)])
    found = find_sinusoids(series, Clock.of(times))
    np.testing.assert_allclose(found.cycles, cycles, atol=1e-3)


class TestNone:
    @pytest.mark.parametrize("noise", [0.0, 0.1])
    @pytest.mark.parametrize("cycles", [(5.0,), (1.0,), (3.0, 7.0, 12.0)])
    def test_of_whole_periods(self, cycles, noise):
        found = find_sinusoids(functions(30, cycles, noise=noise))
        assert not len(found.cycles)
        assert not found.trend

    @pytest.mark.parametrize("seed", range(6))
    @pytest.mark.parametrize(("n_timesteps", "n_pixels"), [(30, 400), (300, 400), (30, 1), (64, 2)])
    def test_of_noise(self, n_timesteps, n_pixels, seed):
        found = find_sinusoids(functions(n_timesteps, (), noise=1.0, n_pixels=n_pixels, seed=seed))
        assert not len(found.cycles)
        assert not found.trend

    def test_of_less_than_one_cycle(self):
        """Not to be told from a drift and an offset."""
        assert not len(find_sinusoids(functions(30, (0.6,))).cycles)

    @pytest.mark.parametrize("series", [np.zeros((2, 30)), np.zeros((0, 30)), np.ones((1, 30)), np.eye(3, 6)])
    def test_of_nothing_or_too_little(self, series):
        assert not len(find_sinusoids(series).cycles)


def test_a_drift_alone_is_a_trend():
    found = find_sinusoids(functions(30, (), drift=1.0, noise=0.05))
    assert found.trend
    assert not len(found.cycles)


def test_of_a_mode_that_rings_down_the_tone_lies_at_its_peak():
    """To 1/e in half the capture: what the tone leaves goes to the bins."""
    found = find_sinusoids(functions(60, (10.4,), decay=5.2))
    assert len(found.cycles) in (0, 1)
    np.testing.assert_allclose(found.cycles, 10.4, atol=0.1)
