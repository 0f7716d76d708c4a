"""Bands from the slider and around peaks, and what is said about them."""

import numpy as np
import pytest

from tg4mm.show.view.colours import band_around, band_of_slider, band_words, main_peaks, peak_labels

FREQUENCIES = np.array([3.4, 3.6, 7.0, 12.0])


def test_the_whole_slider_is_no_band():
    assert band_of_slider(0.0, 15.0, 15.0) is None
    assert band_of_slider(0.0, 14.9, 15.0) == (0.0, 14.9)
    assert band_of_slider(9.0, 4.0, 15.0) == (4.0, 9.0)


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_the_band_around_a_peak_holds_that_peak_alone(frequency):
    low, high = band_around(float(frequency), FREQUENCIES, 15.0)
    inside = FREQUENCIES[(low <= FREQUENCIES) & (high >= FREQUENCIES)]
    assert inside.tolist() == [frequency]


def test_a_band_ends_where_frequencies_end():
    assert band_around(14.5, np.array([14.5]), 15.0)[1] == 15.0


def test_faint_frequencies_get_no_button():
    peaks = np.array([1.0, 0.5, 0.02, 0.06])
    assert main_peaks(FREQUENCIES, peaks, 2.0).tolist() == [3.4, 3.6, 12.0]


def test_drift_gets_a_button_only_where_nothing_else_moves():
    assert main_peaks(np.array([0.1, 5.0]), np.array([9.0, 1.0]), 2.0).tolist() == [5.0]
    assert main_peaks(np.array([0.1]), np.array([9.0]), 2.0).tolist() == [0.1]


def test_labels_tell_close_frequencies_apart():
    assert peak_labels([5.0, 7.25]) == ("5 Hz", "7.25 Hz")
    assert peak_labels([12.341, 12.342]) == ("12.341 Hz", "12.342 Hz")


def test_a_band_without_frequencies_is_said():
    assert "none of the 4" in band_words((1.0, 2.0), FREQUENCIES)
    assert "2 of 4" in band_words((3.0, 4.0), FREQUENCIES)
    assert band_words(None, FREQUENCIES) == "All frequencies (4)."
