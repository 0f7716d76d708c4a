"""Frequency bands: 0 ≤ low < high < fps / 2."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tg4mm.core.errors import CaptureError
from tg4mm.core.magnification import check_band


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.floats(1e-3, 1e6))
def test_a_band_passes_exactly_if_it_lies_below_half_the_frame_rate(low, high, fps):
    if 0 <= low < high < fps / 2:
        assert check_band((low, high), fps) == (low, high)
    else:
        with pytest.raises(CaptureError, match="band"):
            check_band((low, high), fps)


@pytest.mark.parametrize(
    ("band", "fps", "message"),
    [
        ((4.0, 40.0), 30, r"band \(4, 40\) Hz reaches past half the frame rate, 15 Hz \(fps = 30\)"),
        ((4.0, 15.0), 30, "reaches past half the frame rate, 15 Hz"),
        ((-1, 4), 30, r"band \(-1, 4\) Hz starts below 0 Hz"),
        ((4, 4), 30, r"band \(4, 4\) Hz is empty"),
        ((5, 4), 30, "low must be below high"),
        ((math.nan, 4), 30, r"band \(nan, 4\) is not two frequencies"),
        ((1, math.inf), 30, "is not two frequencies"),
        ((1, 2, 3), 30, "is not two frequencies"),
        ("12", 30, "band '12' is not two frequencies"),
        (None, 30, "band None is not two frequencies"),
        ((1, 2), 0.0, r"band \(1, 2\) Hz needs a frame rate, and fps is 0"),
        ((1, 2), math.nan, "fps is nan"),
    ],
)
def test_a_bad_band_is_refused_with_its_numbers(band, fps, message):
    with pytest.raises(CaptureError, match=message):
        check_band(band, fps)
