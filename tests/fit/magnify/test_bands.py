"""Bands with their factors: sums, refusals, and what an α means."""

import numpy as np
import pytest

from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.filters import TemporalFilter
from tg4mm.core.magnification import BandGain, Magnification

FPS = 30.0


def test_every_band_has_its_own_factor():
    plan = Magnification((BandGain(2, 4, 20), BandGain(7, 9, -1)), filter=TemporalFilter("ideal"))
    frequencies = np.array([0.0, 2, 3, 4, 5, 8, 12])
    np.testing.assert_array_equal(plan.ideal(frequencies), [0, 20, 20, 20, 0, -1, 0])
    np.testing.assert_array_equal(plan.response(frequencies, FPS), plan.ideal(frequencies))
    assert plan.checked(FPS) is plan


@pytest.mark.parametrize(
    ("bands", "error", "message"),
    [
        (((1, 3), (2, 5)), Tg4mmError, r"bands \(1, 3\) Hz and \(2, 5\) Hz overlap: 2 Hz lies in both"),
        (((5, 7), (3, 5)), Tg4mmError, r"bands \(3, 5\) Hz and \(5, 7\) Hz overlap: 5 Hz lies in both"),
        (((1, 20),), CaptureError, "reaches past half the frame rate"),
        (((4, 4),), CaptureError, "is empty"),
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
    with pytest.raises(Tg4mmError, match="exclude each other"):
        Magnification((BandGain(1, 2, 3.0),), everywhere=1.0).checked(FPS)
