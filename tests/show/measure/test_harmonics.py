"""A weaker peak at two or three times the frequency of a stronger one may be its harmonic, and says so."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.show.measure.harmonics import Harmonic, harmonics_of
from tg4mm.show.measure.spectrum import spectrum_of

FPS, RESOLUTION = 30.0, 0.5


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
def test_two_and_three_times_a_stronger_frequency(hz: float, size: float, expected: Harmonic | None) -> None:
    assert harmonics_of([7.0, hz], [0.001, 0.001], [1.0, size], FPS, RESOLUTION)[1] == expected


def test_an_uncertain_frequency_is_compared_within_three_deviations() -> None:
    assert harmonics_of([7.0, 14.5], [0.1, 0.001], [1.0, 0.1], FPS, RESOLUTION)[1] == Harmonic(2, 7.0)


def test_a_spectrum_marks_them() -> None:
    times = np.arange(90) / FPS
    values = np.cos(2 * np.pi * 4.6 * times) + 0.05 * np.cos(2 * np.pi * 9.2 * times + 1)
    noise = 0.002 * np.random.default_rng(0).normal(size=(90, 3))
    spread = np.full((90, 3), 0.002)
    strong, weak = spectrum_of(times, values[:, None] * np.ones(3) + noise, spread).peaks
    assert strong.harmonic is None
    assert weak.harmonic is not None
    assert str(weak.harmonic) == "may be a harmonic: 2 × 4.6 Hz"
