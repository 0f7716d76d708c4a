"""Spectra of known series: amplitudes, frequencies between bins, the floor's chance, derivatives, orbits, harmonics."""

import numpy as np
import pytest

from tg4mm.show.measure import spectrum as sp
from tg4mm.show.measure.series import derivatives_of, deviations_of
from tg4mm.show.measure.spectrum import Harmonic, harmonics_of, orbit_in, orbit_of, spectrum_of

TIMES = np.arange(60) / 30.0
ALL = np.ones(3, bool)
FPS, RESOLUTION = 30.0, 0.5


def noisy(values, sigma, seed):
    noise = sigma * np.random.default_rng(seed).normal(size=(len(TIMES), 3))
    return values + noise, np.full((len(TIMES), 3), sigma)


def sinusoid(hz, amplitude=1.0, phase=0.0):
    return amplitude * np.cos(2 * np.pi * hz * TIMES + phase)[:, None] * np.array([1.0, 0.0, 0.5])


@pytest.mark.parametrize("hz", [3.0, 3.13, 3.25, 7.77])
def test_a_tone_between_bins_has_its_frequency_amplitude_and_phase(hz):
    values, sigma = noisy(sinusoid(hz, 1.0, 0.6), 0.05, 1)
    (peak,) = spectrum_of(TIMES, values, sigma).peaks
    assert peak.frequency_hz == pytest.approx(hz, abs=4 * peak.frequency_deviation_hz)
    assert peak.amplitude == pytest.approx([1, 0, 0.5], abs=0.05)
    assert np.angle(peak.phasor[[0, 2]]) == pytest.approx(0.6, abs=0.15)


def test_deviations_are_the_scatter_over_many_records():
    peaks = [spectrum_of(TIMES, *noisy(sinusoid(4.4), 0.2, seed)).peaks[0] for seed in range(60)]
    hz = np.array([p.frequency_hz for p in peaks])
    assert hz.std() == pytest.approx(peaks[0].frequency_deviation_hz, rel=0.3)
    amplitude = np.array([p.amplitude[0] for p in peaks])
    assert amplitude.std() == pytest.approx(peaks[0].deviation[0], rel=0.3)


def test_noise_alone_passes_the_floor_in_few_records_of_many():
    found = sum(bool(spectrum_of(TIMES, *noisy(np.zeros((60, 3)), 1.0, s)).peaks) for s in range(300))
    assert found <= 15  # 1 % of 300, and what finer frequencies than 1 / duration add
    records = (noisy(np.zeros((60, 3)), 1.0, k) for k in range(50))
    low = sum(bool(spectrum_of(TIMES, v, s / 1.5).peaks) for v, s in records)
    assert low <= 3  # noise is what the record itself shows, where less is said of it
    assert sp.CHANCE == 0.01


@pytest.mark.parametrize("missing", [1, 20])
@pytest.mark.parametrize("hz", [12.4, 14.6])
def test_frames_that_are_missing_make_no_frequency_above_half_the_rate(missing, hz):
    rng = np.random.default_rng(missing)
    gone = rng.choice(np.arange(1, 119), missing, replace=False)
    times = np.delete(np.arange(120), gone) / 30.0
    values = np.cos(2 * np.pi * hz * times)[:, None] * np.ones(3) + 0.01 * rng.normal(size=(len(times), 3))
    found = spectrum_of(times, values, np.full((len(times), 3), 0.01))
    assert found.freqs_hz[-1] <= 15.0
    assert found.peaks[0].frequency_hz == pytest.approx(hz, abs=0.02)


def test_a_direction_that_is_not_observed_has_no_peak_and_an_infinite_floor():
    values, sigma = noisy(sinusoid(4.0), 0.05, 2)
    sigma[:, 2] = np.inf
    spectrum = spectrum_of(TIMES, values, sigma)
    assert np.isinf(spectrum.floor[:, 2]).all()
    assert not spectrum.peaks[0].is_above[2]
    assert np.isfinite(spectrum.peaks[0].amplitude).all()


def test_velocity_and_acceleration_of_a_fast_tone():
    values, sigma = noisy(sinusoid(8.2), 1e-4, 0)
    found = derivatives_of(TIMES, values, spectrum_of(TIMES, values, sigma).peaks)
    omega = 2 * np.pi * 8.2
    assert np.abs(found.velocity[:, 0] + omega * np.sin(omega * TIMES)).max() < 0.01 * omega
    assert np.abs(found.acceleration[:, 0] + omega**2 * np.cos(omega * TIMES)).max() < 0.01 * omega**2


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_deviations_of_velocity_and_acceleration_are_their_scatter(share):
    """Over 50 records of a tone and noise; with a share, each record is that much too large or too small."""
    omega, rng, scores = 2 * np.pi * 8.2, np.random.default_rng(7), [[], []]
    velocity = omega * np.array([1.0, 0, 0.5]) * -np.sin(omega * TIMES)[:, None]
    acceleration = omega**2 * np.array([1.0, 0, 0.5]) * -np.cos(omega * TIMES)[:, None]
    for seed in range(50):
        values, sigma = noisy(sinusoid(8.2) * (1 + share * rng.normal()), 0.05, seed)
        peaks = spectrum_of(TIMES, values, sigma, np.full(3, share) if share else None).peaks
        found = derivatives_of(TIMES, values, peaks)
        sure = deviations_of(found, TIMES, sigma, np.full(3, share), peaks)
        scores[0].append((found.velocity - velocity)[2:-2] / sure.velocity[2:-2])
        scores[1].append((found.acceleration - acceleration)[2:-2] / sure.acceleration[2:-2])
    for one in scores:
        inside = np.abs(np.array(one)) < 1
        assert 0.6 < inside[:, :, 0].mean() < 0.88
        assert inside.mean() > 0.6  # a share counts along every axis, whatever moves there


def test_an_orbit_is_the_ellipse():
    angle = 2 * np.pi * 4.0 * TIMES
    values = np.stack([2 * np.cos(angle + 0.3), np.sin(angle + 0.3), 0 * angle], 1)
    orbit = orbit_of(spectrum_of(TIMES, values, np.full((60, 3), 1e-3)).peaks[0])
    assert np.abs(orbit.major) == pytest.approx([2, 0, 0], abs=1e-3)
    assert np.abs(orbit.minor) == pytest.approx([0, 1, 0], abs=1e-3)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_direction_that_is_hardly_seen_does_not_hide_the_others(turn):
    """.4 to the right ± .01, and .3 ± .29 along the sight: the main axis is what is seen; the sight stands apart.

    So it is where the axes are not the sight's own, with their correlation.
    """
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    phasor = axes @ np.array([0.4 * np.exp(0.5j), 0, 0.3])
    covariance = axes @ np.diag([0.01, 0.01, 0.29]) ** 2 @ axes.T
    deviation = np.sqrt(np.diag(covariance))
    orbit = orbit_in(phasor, deviation, ALL, covariance / np.outer(deviation, deviation))
    assert np.abs(orbit.major) == pytest.approx(np.abs(0.4 * axes[:, 0]), abs=1e-6)
    assert orbit.deviation == pytest.approx(0.01)
    assert (orbit.phase - 0.5) % np.pi == pytest.approx(0, abs=1e-6)
    (hidden,) = orbit.hidden
    assert (hidden.amplitude, hidden.deviation) == pytest.approx((0.3, 0.29))
    alike = orbit_in(phasor, deviation, ALL)  # as if the axes were independent
    assert alike.deviation > 0.1 if turn else alike.deviation == pytest.approx(0.01)


def test_a_direction_of_large_noise_is_reported_where_the_motion_stands_out_of_it():
    """A codec leaves noise of .0002 px across a brick wall's joints and of .02 px along them, where .3 px vibrate."""
    rng, angle = np.random.default_rng(0), 2 * np.pi * 4.0 * TIMES
    noise = np.array([2e-4, 2e-2])
    values = np.stack([0.002 * np.sin(angle), 0.3 * np.cos(angle)], 1) + rng.normal(0, noise, (60, 2))
    orbit = orbit_of(spectrum_of(TIMES, values, np.tile(noise, (60, 1))).peaks[0])
    assert orbit.amplitude == pytest.approx(0.3, abs=0.015)
    quiet = np.stack([0.002 * np.sin(angle), rng.normal(0, 0.02, 60)], 1)
    orbit = orbit_of(spectrum_of(TIMES, quiet, np.tile(noise, (60, 1))).peaks[0])
    assert orbit.amplitude == pytest.approx(0.002, abs=2e-4)  # noise along the joints is left out


def test_a_stated_direction_is_a_part_of_the_main_axis_however_unsure():
    orbit = orbit_in(np.array([0.4, 0, 0.9], complex), np.array([0.01, 0.01, 0.29]), ALL)
    assert orbit.amplitude == pytest.approx(np.hypot(0.4, 0.9))
    assert not orbit.hidden


def test_of_noise_alike_along_all_axes_a_clear_main_axis_keeps_all():
    orbit = orbit_in(np.array([0.4, 0.1, 0.0], complex), np.full(3, 0.1), ALL)
    assert orbit.amplitude == pytest.approx(np.hypot(0.4, 0.1))
    assert orbit.stands_out


@pytest.mark.parametrize(
    ("hz", "size", "expected"),
    [
        (14.0, 0.1, Harmonic(2, 7.0)),
        (14.2, 0.1, Harmonic(2, 7.0)),  # within half of 1 / duration
        (9.0, 0.1, Harmonic(3, 7.0)),  # 21 Hz, seen at 30 − 21
        (14.4, 0.1, None),
        (14.0, 2.0, None),  # a stronger one is none
        (3.5, 0.1, None),
    ],
)
def test_two_and_three_times_a_stronger_frequency(hz, size, expected):
    assert harmonics_of([7.0, hz], [0.001, 0.001], [1.0, size], FPS, RESOLUTION)[1] == expected
    odd = [harmonics_of([6.7, 26.5], [1e-3, 1e-3], [1.0, share], 60.0, 0.1)[1] for share in (0.15, 0.25)]
    assert odd == [Harmonic(5, 6.7), None]  # 33.5 Hz at 60 Hz, up to a fifth
    uncertain = harmonics_of([7.0, 14.5], [0.1, 0.001], [1.0, 0.1], FPS, RESOLUTION)
    assert uncertain[1] == Harmonic(2, 7.0)  # within three deviations
    # Of what has hardly one.
    assert harmonics_of([7.0, 14.5], [0.2, 0.001], [1.0, 0.1], FPS, RESOLUTION)[1] is None


def test_a_band_that_is_given_has_a_peak_though_one_period_makes_none():
    """Two seconds at 0.5 Hz; a band that holds a peak that was found stays as it is."""
    values, sigma = noisy(sinusoid(0.5, 1.0, 0.6), 0.05, 1)
    share = np.zeros(3)
    found = spectrum_of(TIMES, values, sigma)
    assert found.peaks == ()
    (asked,) = sp.with_band(found, (0.4, 0.6), TIMES, values, sigma, share).peaks
    assert asked.requested.band == (0.4, 0.6)
    assert asked.amplitude == pytest.approx([1, 0, 0.5], abs=2 * asked.deviation.max())
    assert 0.1 < asked.deviation[0] < 0.5
    fast = spectrum_of(TIMES, *noisy(sinusoid(7.7), 0.05, 1))
    assert sp.with_band(fast, (7, 8), TIMES, values, sigma, share) is fast


def test_a_spectrum_marks_them():
    times = np.arange(90) / FPS
    values = np.cos(2 * np.pi * 4.6 * times) + 0.05 * np.cos(2 * np.pi * 9.2 * times + 1)
    noise = 0.002 * np.random.default_rng(0).normal(size=(90, 3))
    spread = np.full((90, 3), 0.002)
    strong, weak = spectrum_of(times, values[:, None] * np.ones(3) + noise, spread).peaks
    assert strong.harmonic is None
    assert weak.harmonic is not None
    assert str(weak.harmonic) == "may be a harmonic: 2 × 4.6 Hz"
