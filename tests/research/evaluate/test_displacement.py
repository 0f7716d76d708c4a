"""Displacement error, direction, leak and amplitude against closed forms, and what a run says of its uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.synthetic import with_phasors
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.displacement import displacement_figures, frequency_figures
from tg4mm.research.evaluate.scores import uncertainty_figures, unresolved

FPS, T, N = 30.0, 30, 40
MANY = 400


def motion(modes, fps=FPS, n_timesteps=T):
    displacement = np.stack(list(modes.values())).astype(np.complex64)
    return ModalMotion.of_phasors(
        np.array(list(modes)), displacement, np.zeros_like(displacement), fps, n_timesteps
    )


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def true(rng):
    return motion({3.0: 1e-3 * (rng.standard_normal((N, 3)) + 1j * rng.standard_normal((N, 3)))})


def test_a_phase_error_is_found_with_its_sign(true):
    """Shifted by φ, a sinusoid is off by 2 sin(φ/2) of its rms."""
    phi = np.radians(18)
    late = with_phasors(true, displacement=np.exp(1j * phi) * true.displacement)
    figures = displacement_figures(late, true, np.ones(N))
    assert figures["relative_error"] == pytest.approx(2 * np.sin(phi / 2), rel=1e-5)
    row = figures["per_frequency"][0]
    assert row["phase_error_deg"] == pytest.approx(18, rel=1e-5)
    assert row["direction_error_deg"] == pytest.approx(0, abs=1e-4)
    assert row["relative_error"] == pytest.approx(2 * np.sin(phi / 2), rel=1e-5)


def test_a_turned_direction_is_found_and_weighted(rng):
    """Half of the weight turned by 30°, with an opposite sign that is a matter of phase, not of direction."""
    along = np.zeros((4, 3))
    along[:, 0] = 2e-3
    turned = along.copy()
    turned[2:] = -2e-3 * np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0])
    both = motion({3.0: -1j * turned}), motion({3.0: -1j * along})
    (row,) = frequency_figures(*both, np.array([1, 1, 3, 3]))
    assert row["direction_error_deg"] == pytest.approx(0.75 * 30, rel=1e-5)
    assert row["amplitude_true"] == pytest.approx(2e-3)


def test_the_error_is_the_weighted_rms_over_time_and_gaussians(true, rng):
    noise = motion({3.0: 1e-4 * rng.standard_normal((N, 3)), 7.0: 2e-4j * rng.standard_normal((N, 3))})
    estimated = motion({3.0: true.displacement[0] + noise.displacement[0], 7.0: noise.displacement[1]})
    weights = rng.uniform(0, 5, N)
    t = np.arange(T)[:, None, None]

    def series(m):
        modes = zip(m.freqs_hz, m.displacement, strict=True)
        return sum((d * np.exp(2j * np.pi * f * t / FPS)).real for f, d in modes)

    def rms(x):
        return float(np.sqrt(((x**2).sum(2) * weights).sum() / (T * weights.sum())))

    expected = rms(series(estimated) - series(true)) / rms(series(true))
    figures = displacement_figures(estimated, true, weights)
    assert figures["relative_error"] == pytest.approx(expected, rel=1e-6)
    assert figures["rms_true"] == pytest.approx(rms(series(true)), rel=1e-6)
    heavier = displacement_figures(estimated, true, 7 * weights)
    assert heavier["relative_error"] == pytest.approx(expected, rel=1e-6)
    assert abs(displacement_figures(estimated, true, np.ones(N))["relative_error"] - expected) > 1e-4


def test_a_known_leak_is_measured():
    """Half of the Gaussians move by 1, the others stand still (one creeps below 1 %) and are given 0.05."""
    true, estimated = np.zeros((4, 3)), np.zeros((4, 3))
    true[:2, 2], true[3, 2] = 1e-3, 0.5e-5
    estimated[:2, 2], estimated[2:, 0] = 1e-3, 0.05e-3
    weights = np.array([2.0, 2.0, 1.0, 1.0])
    figures = displacement_figures(motion({3.0: estimated}), motion({3.0: true}), weights)
    assert figures["static_leak"] == pytest.approx(0.05, rel=1e-5)
    assert figures["static_share"] == pytest.approx(1 / 3)
    none_still = displacement_figures(motion({3.0: estimated[:2]}), motion({3.0: true[:2]}), weights[:2])
    assert none_still["static_leak"] is None


def test_lengths_are_in_mm_only_when_the_scale_is_known(true):
    plain = displacement_figures(true, true, np.ones(N))
    scaled = displacement_figures(true, true, np.ones(N), unit_scale_m=0.2)
    assert not [k for k in [*plain, *plain["per_frequency"][0]] if k.endswith("_mm")]
    assert scaled["rms_true_mm"] == pytest.approx(200 * plain["rms_true"])
    row = scaled["per_frequency"][0]
    assert row["amplitude_true_mm"] == pytest.approx(200 * row["amplitude_true"])


def test_each_frequency_is_judged_by_itself():
    a, b = np.zeros((2, 3)), np.zeros((2, 3))
    a[:, 0], b[:, 1] = 1e-3, 4e-3
    rows = frequency_figures(motion({5.0: b * 0.5, 3.0: a, 9.0: b}), motion({3.0: a, 5.0: b}), np.ones(2))
    assert [r["frequency_hz"] for r in rows] == [3.0, 5.0]
    assert [r["amplitude_ratio"] for r in rows] == pytest.approx([1.0, 0.5], rel=1e-6)
    assert [r["amplitude_true"] for r in rows] == pytest.approx([1e-3, 4e-3], rel=1e-6)


def test_a_frequency_between_bins_is_compared_by_what_both_do_there():
    """4.5 Hz seen for one second, rebuilt from its DFT bins: none holds 4.5 Hz, yet it is the same motion."""
    shape = np.array([[1e-3, 0, 0], [0, 2e-3, 0]])
    true = motion({4.5: -1j * shape})
    t = np.arange(T)
    spectrum = np.fft.rfft(np.sin(2 * np.pi * 4.5 * t / FPS)) * 2 / T
    spectrum[[0, -1]] /= 2
    bins = motion({float(f): c * shape for f, c in zip(np.fft.rfftfreq(T, 1 / FPS), spectrum, strict=True)})
    figures = displacement_figures(bins, true, np.ones(2))
    assert figures["relative_error"] < 1e-5
    assert figures["per_frequency"][0]["amplitude_ratio"] == pytest.approx(1, rel=1e-5)
    assert figures["per_frequency"][0]["relative_error"] < 1e-5


@pytest.mark.parametrize("frequency", [0.0, 15.0])
def test_the_ends_of_the_spectrum_are_not_counted_twice(frequency):
    row = frequency_figures(*[motion({frequency: np.full((2, 3), 1e-3)})] * 2, np.ones(2))[0]
    assert row["amplitude_true"] == pytest.approx(np.sqrt(3) * 1e-3, rel=1e-6)


def test_what_does_not_fit_together_is_refused(true):
    with pytest.raises(ValueError, match="'weights': 39"):
        displacement_figures(true, true, np.ones(N - 1))
    with pytest.raises(ValueError, match=r"\(25.0, 30\), \(30.0, 30\)"):
        displacement_figures(replace(true, fps=25.0), true, np.ones(N))
    with pytest.raises(ValueError, match="sum is 0"):
        displacement_figures(true, true, np.zeros(N))


@pytest.fixture
def errors():
    """Peak displacement errors [N, 3] along x, a half normal of 1e-3."""
    out = np.zeros((MANY, 3))
    out[:, 0] = 1e-3 * np.abs(np.random.default_rng(0).standard_normal(MANY))
    return out


def test_errors_are_rms_over_time_and_weighted(errors):
    weights = np.zeros(MANY)
    weights[:2] = 1, 3
    still = motion({3.0: 0 * errors})
    figures = uncertainty_figures(motion({3.0: errors}), still, weights, np.full(MANY, 2e-3))
    # Of a sinusoid: half its peak squared.
    expected = np.sqrt((errors[0, 0] ** 2 + 3 * errors[1, 0] ** 2) / 4 / 2)
    assert figures["error"] == pytest.approx(expected, rel=1e-4)
    assert figures["said"] == pytest.approx(2e-3, rel=1e-6)


def test_a_record_of_less_than_a_period_is_marked(true):
    """Six timesteps of 3 Hz are six tenths of a period; ten are one, and resolve it."""
    (what, why), *others = unresolved(replace(true, n_timesteps=6)).items()
    assert not others
    assert what == "the motion at 3 Hz"
    assert "6 timesteps at 30 Hz holds 0.6 of its period" in why
    assert "10 timesteps or more" in why
    assert not unresolved(replace(true, n_timesteps=10))
