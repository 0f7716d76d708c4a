"""One-third-octave spectra of records whose levels are known."""

import numpy as np
import pytest

from tests.show.analyse.systems import channel
from tg4mm.show.analyse.quantities import midbands, third_octaves_of

RATE, SECONDS = 60.0, 20.0
T = np.arange(int(RATE * SECONDS)) / RATE


def test_midbands_are_those_of_base_ten():
    """0.8 to 25 Hz of the standard's table by their exact values; a band's edges meet those of the next."""
    found = midbands(0.7, 29.0)
    nominal = [0.8, 1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8, 10, 12.5, 16, 20, 25]
    np.testing.assert_allclose(found, nominal, rtol=0.012)
    assert 1.0 in found.round(12)
    bands = [b.band_hz for b in third_octaves_of(channel(T, RATE), "displacement")]
    np.testing.assert_allclose([high for _, high in bands[:-1]], [low for low, _ in bands[1:]])
    assert bands[-1][1] <= RATE / 2


@pytest.mark.parametrize(("quantity", "order"), [("displacement", 0), ("velocity", 1), ("acceleration", 2)])
def test_a_sinusoid_has_its_rms_in_its_band_alone(quantity, order):
    """In the middle of a band, so that what the window spreads stays within."""
    values = 0.2 * np.cos(2 * np.pi * 10 * T + 0.3)
    rms = {round(b.midband_hz, 3): b.rms.value for b in third_octaves_of(channel(values, RATE), quantity)}
    assert rms[10.0] == pytest.approx(0.2 / np.sqrt(2) * (2 * np.pi * 10) ** order, rel=0.01)
    assert max(v for hz, v in rms.items() if hz != 10.0) < 0.01 * rms[10.0]


def test_bands_of_white_noise_share_its_power_by_their_width():
    powers = []
    for seed in range(40):
        white = channel(np.random.default_rng(seed).normal(size=len(T)), RATE)
        powers.append([band.rms.value**2 for band in third_octaves_of(white, "displacement")])
    found = np.mean(powers, axis=0)
    bands = [b.band_hz for b in third_octaves_of(channel(T, RATE), "displacement")]
    np.testing.assert_allclose(found, [2 / RATE * (high - low) for low, high in bands], rtol=0.2)


def test_values_scatter_by_their_deviations_and_noise_alone_is_none():
    """A tone of three times the noise in its band; the others hold noise alone."""
    true, scores, false = 0.03 / np.sqrt(2), [], []
    for seed in range(200):
        tone = channel(0.03 * np.cos(2 * np.pi * 5 * T + seed), RATE, 0.05, seed)
        for b in third_octaves_of(tone, "displacement"):
            if b.band_hz[0] < 5 < b.band_hz[1]:
                scores.append((b.rms.value - true) / b.rms.deviation)
            elif not b.band_hz[0] / 1.6 < 5 < b.band_hz[1] * 1.6:
                false.append(b.rms.value > 2 * b.rms.deviation)
    assert 0.6 < np.mean(np.abs(scores) < 1) < 0.95
    assert np.mean(np.abs(scores) < 2) > 0.92
    assert np.mean(false) < 0.06


def test_a_record_too_short_for_any_band_has_none():
    assert not list(third_octaves_of(channel(np.cos(T[:12]), RATE), "displacement"))
