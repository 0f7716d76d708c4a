"""Temporal filters: what passes, what does not, and how late it comes out."""

import numpy as np
import pytest

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.filters import TemporalFilter, apply_response, bins

FPS = 30.0
# [TG4MM] §IV.B: the bands of the published scenes
BANDS = {3.0: (1.5, 4.5), 5.0: (3.5, 6.5)}


def filtered(kind, frequency, n=30, taps=0):
    """(a cosine of unit amplitude, what the filter makes of it) over n timesteps."""
    x = np.cos(2 * np.pi * frequency * np.arange(n) / FPS)
    response = TemporalFilter(kind, taps).response(BANDS[frequency], bins(n, FPS), FPS)
    return x, apply_response(x, response)


@pytest.mark.parametrize(("frequency", "degrees", "error"), [(3.0, 18.0, 0.3129), (5.0, 30.0, 0.5176)])
def test_the_published_filter_is_half_a_sample_early(frequency, degrees, error):
    response = TemporalFilter("published").response(BANDS[frequency], [frequency], FPS)[0]
    assert abs(response) == pytest.approx(1, abs=1e-9)  # in the middle of the band
    assert np.degrees(np.angle(response)) == pytest.approx(degrees, abs=1e-9)
    x, y = filtered("published", frequency)
    assert np.linalg.norm(y - x) / np.linalg.norm(x) == pytest.approx(error, abs=1e-4)
    early = np.cos(2 * np.pi * frequency * (np.arange(30) + 0.5) / FPS)
    np.testing.assert_allclose(y, early, atol=1e-9)


@pytest.mark.parametrize("frequency", [3.0, 5.0])
@pytest.mark.parametrize("kind", ["zero-phase", "ideal"])
@pytest.mark.parametrize("n", [30, 60, 300, 12])
def test_the_others_have_no_phase_error(kind, frequency, n):
    if n == 12 and frequency == 3.0:
        n = 20  # whole periods, shorter than the filter
    response = TemporalFilter(kind).response(BANDS[frequency], bins(n, FPS), FPS)
    assert np.abs(response.imag).max() < 1e-12
    x, y = filtered(kind, frequency, n)
    np.testing.assert_allclose(y, x, atol=1e-9)


@pytest.mark.parametrize("kind", ["zero-phase", "ideal", "published"])
def test_what_is_outside_the_band_does_not_pass(kind):
    n = 120
    t = np.arange(n) / FPS
    x = 3.0 + np.sin(2 * np.pi * 11 * t)
    y = apply_response(x, TemporalFilter(kind).response((3.5, 6.5), bins(n, FPS), FPS))
    assert np.abs(y).max() < (1e-12 if kind == "ideal" else 0.02)


def test_a_series_of_any_shape_is_filtered_along_time_and_keeps_float32():
    x = np.random.default_rng(0).standard_normal((20, 3, 5)).astype(np.float32)
    response = TemporalFilter("ideal").response((2.0, 7.0), bins(20, FPS), FPS)
    y = apply_response(x, response)
    assert y.dtype == np.float32
    spectrum = np.fft.rfft(x.astype(float), axis=0)
    spectrum[(bins(20, FPS) < 2) | (bins(20, FPS) > 7)] = 0
    np.testing.assert_allclose(y, np.fft.irfft(spectrum, 20, axis=0), atol=1e-5)
    with pytest.raises(ValueError, match=r"response has shape \(11,\), expected \(10,\) for T = 19"):
        apply_response(x[:19], response)


@pytest.mark.parametrize(
    ("kind", "taps", "message"),
    [
        ("butter", 0, "filter is 'butter', expected zero-phase, ideal, published"),
        ("zero-phase", 30, "filter length is 30, expected an odd number of at least 3"),
        ("published", 31, "filter length is 31, expected an even number"),
        ("zero-phase", 1, "filter length is 1"),
    ],
)
def test_a_filter_that_cannot_be_is_refused(kind, taps, message):
    with pytest.raises(Tg4mmError, match=message):
        TemporalFilter(kind, taps).checked()
