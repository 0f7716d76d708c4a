"""Linear magnification: of a series, and of modal motion, where it is what `modal` does.

Bands with their factors: sums, refusals, and what an α means.

Temporal filters: what passes, what does not, and how late it comes out.
"""

import numpy as np
import pytest

from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.magnification import BandGain, Magnification, TemporalFilter, apply_response, bins
from tg4mm.fit.magnify import magnified_motion, magnified_series
from tg4mm.fit.motion.animate import displacement_at, rotation_at
from tg4mm.fit.motion.modes import ModalMotion

FPS = 30.0
IDEAL = TemporalFilter("ideal")
# [TG4MM] §IV.B: the bands of the published scenes
BANDS = {3.0: (1.5, 4.5), 5.0: (3.5, 6.5)}


def motion(freqs, n_timesteps, seed=0):
    rng = np.random.default_rng(seed)
    shape = (2, len(freqs), 7, 3)
    phasors = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
    return ModalMotion.of_phasors(np.array(freqs), phasors[0], 0.1 * phasors[1], FPS, n_timesteps)


@pytest.mark.parametrize("n", [30, 45, 60])
def test_ideal_bands_on_dft_bins_are_what_modal_does(n):
    m = motion([2.0, 4.0, 6.0, 10.0], n)
    plan = Magnification((BandGain(3.5, 6.5, 20.0), BandGain(9, 11, -1.0)), filter=IDEAL)
    linear, alphas = magnified_motion(m, plan), plan.ideal(m.freqs_hz)
    for t in range(n):
        for at in (displacement_at, rotation_at):
            np.testing.assert_allclose(at(linear, t), at(m, t, alphas), atol=1e-4)


def test_the_published_filter_puts_its_phase_error_into_the_result():
    m = motion([5.0], 30)
    filters = map(TemporalFilter, ("published", "zero-phase"))
    gains = (BandGain(3.5, 6.5, 50.0),)
    wrong, right = (magnified_motion(m, Magnification(gains, filter=own)) for own in filters)
    series = {
        name: np.stack([displacement_at(x, t) for t in range(30)])
        for name, x in (("wrong", wrong), ("right", right))
    }
    truth = np.stack([displacement_at(m, t, 50.0) for t in range(30)])
    np.testing.assert_allclose(series["right"], truth, atol=2e-3)
    # 50 of the 51 parts are turned by 30°: 2 sin(15°) · 50/51
    error = np.linalg.norm(series["wrong"] - truth) / np.linalg.norm(truth)
    assert error == pytest.approx(0.5176 * 50 / 51, abs=1e-3)


def test_the_series_is_filtered_relative_to_timestep_0():
    rng = np.random.default_rng(0)
    series = 1000 + rng.standard_normal((30, 4))
    everything = magnified_series(series, np.full(16, 4.0))
    np.testing.assert_allclose(everything, series + 4 * (series - series[0]), atol=1e-9)
    band = IDEAL.response((3.5, 6.5), bins(30, FPS), FPS)
    outside = magnified_series(series, 50 * (1 - band))
    change = np.fft.rfft(outside - series, axis=0)
    assert np.abs(change[4:7]).max() < 1e-8


def test_every_band_has_its_own_factor():
    plan = Magnification((BandGain(2, 4, 20), BandGain(7, 9, -1)), filter=TemporalFilter("ideal"))
    frequencies = np.array([0.0, 2, 3, 4, 5, 8, 12])
    np.testing.assert_array_equal(plan.ideal(frequencies), [0, 20, 20, 20, 0, -1, 0])
    np.testing.assert_array_equal(plan.response(frequencies, FPS), plan.ideal(frequencies))
    assert plan.checked(FPS) is plan
    assert Magnification.of(3.0).checked(FPS).alpha == 3.0


@pytest.mark.parametrize(
    ("bands", "error", "message"),
    [
        (((1, 3), (2, 5)), Tg4mmError, r"bands \(1, 3\) Hz and \(2, 5\) Hz overlap: 2 Hz lies in both"),
        (((5, 7), (3, 5)), Tg4mmError, r"bands \(3, 5\) Hz and \(5, 7\) Hz overlap: 5 Hz lies in both"),
        (((1, 20),), CaptureError, "reaches past half the frame rate"),
    ],
)
def test_bands_that_cannot_be_are_refused(bands, error, message):
    with pytest.raises(error, match=message):
        Magnification(tuple(BandGain(*b, 5.0) for b in bands)).checked(FPS)


def test_other_nonsense_is_refused():
    with pytest.raises(Tg4mmError, match="method is 'magic', expected modal, linear, phase"):
        Magnification(method="magic").checked(FPS)
    with pytest.raises(Tg4mmError, match="alpha is nan"):
        Magnification((BandGain(1, 2, float("nan")),)).checked(FPS)
    with pytest.raises(Tg4mmError, match="amplitude percentile is 100, expected 0 to below 100"):
        Magnification(amplitude_percentile=100.0).checked(FPS)
    with pytest.raises(Tg4mmError, match="give one"):
        Magnification(suppressed=True).checked(FPS)
    with pytest.raises(Tg4mmError, match="cannot be used together"):
        Magnification((BandGain(1, 2, 3.0),), everywhere=1.0).checked(FPS)


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
    assert TemporalFilter(kind).length(FPS) == (30 if kind == "published" else 31)


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
