"""Frequencies are found between bins, with frames dropped, from clocks of their own; and in noise there are none."""

from pathlib import Path

import numpy as np
import pytest

from tg4mm.fit.motion.temporal.frequencies import find_frequencies

FPS, SERIES = 30.0, 80
HZ = (3.437, 7.113)
BAND = (0.7, 13.5)


def times(n_frames=90, dropped=6, seed=0):
    """Seconds, of a phone: some frames are missing, steps are not quite even."""
    rng = np.random.default_rng(seed)
    kept = np.sort(rng.choice(np.arange(1, n_frames - 1), n_frames - 2 - dropped, replace=False))
    return (np.array([0, *kept, n_frames - 1]) + 0.02 * rng.normal(size=n_frames - dropped)) / FPS


def moving(t, seed, hz=HZ, strength=1.0, noise=1.0):
    """[F, S]: noise of variance 1; half of the series move with the first frequency, a tenth with the second."""
    rng = np.random.default_rng(seed)
    y = noise * rng.normal(size=(len(t), SERIES))
    for k, f in enumerate(hz):
        own = rng.permutation(SERIES) < SERIES * (0.5, 0.1)[k]
        amplitude = strength * own * rng.uniform(0.5, 1.5, SERIES)
        y += amplitude * np.cos(2 * np.pi * f * t[:, None] + rng.uniform(0, 2 * np.pi, SERIES))
    return y


def check(found, hz):
    """These, within three of the deviations that it states, which are small; and nothing else."""
    assert len(found.hz) == len(hz)
    for f in hz:
        k = int(np.argmin(np.abs(found.hz - f)))
        assert abs(found.hz[k] - f) < 3 * found.deviation_hz[k]
        assert found.deviation_hz[k] < 0.1


def test_two_between_bins_are_found_and_nothing_else():
    """Three seconds: bins are a third of a Hz apart.

    Of 60 draws, 57 had both and nothing else, two a third and one the first alone: of twelve, nine or more in 99.8 %.
    """
    counts = []
    for seed in range(12):
        t = times(seed=seed)
        found = find_frequencies([moving(t, seed)], [t], *BAND)
        assert abs(found.hz[0] - HZ[0]) < 4 * found.deviation_hz[0] < 0.1  # the strongest first
        counts.append(len(found.hz))
    assert counts.count(2) >= 9


@pytest.mark.parametrize("seed", range(6))
def test_in_noise_there_are_none(seed):
    t = times(seed=seed)
    y = np.random.default_rng(seed).normal(size=(len(t), SERIES)) * np.geomspace(1, 100, SERIES)
    assert not len(find_frequencies([y], [t], *BAND).hz)


def test_clips_with_phases_of_their_own_are_put_together():
    """Four clips, of which no one series is like another's."""
    clocks = [times(60, 3, seed) + 17.3 * seed for seed in range(4)]
    series = [moving(t, seed, strength=0.6) for seed, t in enumerate(clocks)]
    check(find_frequencies(series, clocks, 1.1, 13.5), HZ)


def test_a_drift_is_no_frequency():
    t = times()
    y, drift = moving(t, 0), 10 * t + 4 * (t - 1.2) ** 2
    without = find_frequencies([y], [t], *BAND)
    np.testing.assert_allclose(find_frequencies([y + drift[:, None]], [t], *BAND).hz, without.hz, atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_rises_to_low_frequencies_is_no_frequency(seed):
    """Six tenths of the noise stay from frame to frame."""
    rng, t = np.random.default_rng(seed), times()
    y = rng.normal(size=(len(t), SERIES))
    for k in range(1, len(t)):
        y[k] += 0.6 * y[k - 1]
    assert not len(find_frequencies([y], [t], *BAND).hz)


def test_the_deviation_is_that_of_the_errors():
    """Rms over twelve draws of error over deviation: about 1."""
    ratios = []
    for seed in range(12):
        t = times(seed=seed)
        found = find_frequencies([moving(t, 100 + seed, HZ[:1], strength=0.4)], [t], *BAND)
        ratios.append((found.hz[0] - HZ[0]) / found.deviation_hz[0])
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_a_loud_one_in_a_short_record_is_found_in_spite_of_its_side_lobes():
    """Shifts of 25 regions of the microphone, generated at 3.4 Hz, before eight cameras with clocks of their own."""
    stored = np.load(Path(__file__).parent / "data/rig_shifts.npz")
    series = list(stored["shifts"].astype(np.float64))
    found = find_frequencies(series, [stored["times_s"].astype(np.float64)] * 8, 1.02, 14.7)
    assert found.hz[0] == pytest.approx(3.4, abs=0.005)


@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_errors_of_clips_are_within_two_deviations(lag):
    """At least 17 of 20 draws: five clips, whose phase lags by `lag` radians more after the first half second."""
    t = np.arange(75) / FPS
    within, stated = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        series = []
        for _ in range(5):
            phase = rng.uniform(0, 2 * np.pi) - lag * (1 - np.exp(-t / 0.3))
            wave = np.cos(2 * np.pi * 3.4 * t + phase)
            series.append(wave[:, None] * rng.normal(0, 4, 24) + rng.normal(size=(len(t), 24)))
        found = find_frequencies(series, [t] * 5, 0.8, 14.7)
        within.append(abs(found.hz[0] - 3.4) < 2 * found.deviation_hz[0])
        stated.append(found.deviation_hz[0])
    assert sum(within) >= 17
    assert np.median(stated) < 0.01
