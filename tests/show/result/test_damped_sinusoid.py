"""How sure a frequency is, against how far it is off; and damping where there is some."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.show.result.damped_sinusoid import DampedSinusoid, damped_sinusoid_of

FPS, N = 30.0, 60
NONE = np.zeros(0)
T = np.arange(N) / FPS


def wave(hz: float, decay: float = 0.0, phase: float = 0.3) -> np.ndarray:
    return np.exp(-decay * T) * np.cos(2 * np.pi * hz * T + phase)


def coloured(rng: np.random.Generator, size: float, memory: float) -> np.ndarray:
    """An autoregressive series; memory 0: white."""
    out = np.zeros(N)
    for i, x in enumerate(rng.normal(0, size * np.sqrt(1 - memory**2), N)):
        out[i] = x + (memory * out[i - 1] if i else 0)
    return out


def fitted_hz(series: np.ndarray, near: float) -> float:
    """The highest point of a fine periodogram: what a run would name."""
    grid = np.linspace(near - 0.4, near + 0.4, 1601)
    return float(grid[np.abs(np.exp(-2j * np.pi * np.outer(grid, T)) @ series).argmax()])


@pytest.mark.parametrize("memory", [0.0, 0.7])
@pytest.mark.parametrize("size", [0.02, 0.2])
def test_errors_are_as_large_as_stated(size: float, memory: float) -> None:
    """Rms of error over stated deviation: 1 where both are right. Larger would be too sure, much smaller useless."""
    rng = np.random.default_rng(1)
    ratios = []
    for _ in range(60):
        hz = rng.uniform(4, 6)
        series = wave(hz, phase=rng.uniform(0, 6)) + coloured(rng, size, memory)
        named = fitted_hz(series, hz)
        ratios.append((named - hz) / damped_sinusoid_of(series, FPS, named, NONE, 0.0).deviation_hz)
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.2


def test_white_noise_gives_about_the_cramer_rao_bound() -> None:
    size, rng = 0.1, np.random.default_rng(0)
    bound = np.sqrt(6) * size / (np.pi * np.sqrt(N) * N / FPS)
    stated = [
        damped_sinusoid_of(wave(5.3) + rng.normal(0, size, N), FPS, 5.3, NONE, 0.0).deviation_hz
        for _ in range(20)
    ]
    assert bound < np.median(stated) < 3 * bound


def test_a_clean_series_is_no_surer_than_its_noise_in_space() -> None:
    """A fit that shrank all noise away leaves none in the series; the two halves tell of it."""
    perfect = damped_sinusoid_of(wave(5.0), FPS, 5.0, NONE, 0.0).deviation_hz
    told = damped_sinusoid_of(wave(5.0), FPS, 5.0, NONE, 0.1).deviation_hz
    assert perfect < 1e-6
    assert told == pytest.approx(np.sqrt(6) * 0.1 / np.sqrt(2) / (np.pi * np.sqrt(N) * N / FPS), rel=0.1)


def test_a_frequency_beside_that_of_the_series_is_as_uncertain_as_that() -> None:
    assert damped_sinusoid_of(wave(5.2), FPS, 5.0, NONE, 0.0).deviation_hz == pytest.approx(0.2, rel=0.01)


def test_another_frequency_and_a_trend_are_no_noise() -> None:
    series = wave(5.0) + 0.8 * wave(7.3, phase=1.0) + 0.5 + 0.4 * T
    assert damped_sinusoid_of(series, FPS, 5.0, np.array([7.3]), 0.0).deviation_hz < 1e-6
    assert damped_sinusoid_of(series, FPS, 5.0, NONE, 0.0).deviation_hz > 1e-3


def test_a_record_too_short_knows_a_bin() -> None:
    found = damped_sinusoid_of(wave(5.0)[:6], FPS, 5.0, NONE, 0.0)
    assert found == DampedSinusoid(pytest.approx(5.0 / np.sqrt(12)), None, None, "the record is too short")


def test_a_ring_down_has_a_damping_ratio() -> None:
    rng, decay = np.random.default_rng(3), 1.5
    ratio = decay / (2 * np.pi * 5.2)
    found = damped_sinusoid_of(wave(5.2, decay) + rng.normal(0, 0.02, N), FPS, 5.2, NONE, 0.0)
    assert found.damping == pytest.approx(ratio, abs=3 * found.damping_deviation)
    assert 0 < found.damping_deviation < 0.2 * ratio
    assert found.why_no_damping == ""


@pytest.mark.parametrize(("decay", "said"), [(0.0, "stays as strong"), (-1.0, "grows")])
def test_a_vibration_that_does_not_ring_down_tells_no_damping(decay: float, said: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        found = damped_sinusoid_of(wave(5.2, decay) + rng.normal(0, 0.05, N), FPS, 5.2, NONE, 0.0)
        assert found.damping is None
        assert said in found.why_no_damping


@pytest.mark.parametrize(("ratio", "hz", "seconds"), [(0.10, 8.0, 3.0), (0.05, 12.0, 4.0)])
def test_a_decay_that_is_over_early_has_no_ratio_rather_than_a_wrong_one(
    ratio: float, hz: float, seconds: float
) -> None:
    t = np.arange(int(seconds * FPS)) / FPS
    series = np.exp(-ratio * 2 * np.pi * hz * t) * np.cos(2 * np.pi * hz * t)
    found = damped_sinusoid_of(series, FPS, hz, NONE, 0.0)
    assert found.damping is None
    assert found.why_no_damping == "it dies out too early in the record"
    slower = damped_sinusoid_of(
        np.exp(-0.02 * 2 * np.pi * hz * t) * np.cos(2 * np.pi * hz * t), FPS, hz, NONE, 0.0
    )
    assert slower.damping == pytest.approx(0.02, rel=0.05)
