"""Suggested bands hold their own frequency, no other one, and suit every command."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from tg4mm.core.magnification import check_band
from tg4mm.show.result.advice import suggested_bands


def test_one_step_of_resolution_to_either_side() -> None:
    assert suggested_bands([5.0], [0.001], 1.0, 30.0) == [(4.0, 6.0)]
    assert suggested_bands([3.3992], [0.002], 3.0, 30.0) == [(3.07, 3.73)]


def test_a_frequency_that_is_hardly_known_gets_more() -> None:
    assert suggested_bands([5.0], [0.5], 3.0, 30.0) == [(3.5, 6.5)]


def test_neighbours_and_half_the_frame_rate_are_kept_out() -> None:
    bands = suggested_bands([5.0, 6.0], [0.01, 0.01], 1.0, 30.0)
    assert bands == [(4.0, 5.5), (5.5, 7.0)]
    assert suggested_bands([14.5], [0.01], 1.0, 30.0)[0][1] < 15.0


@settings(deadline=None)
@given(
    hz=st.lists(st.floats(0.7, 14.9), min_size=1, max_size=5, unique=True),
    deviation=st.floats(1e-5, 3.0),
    duration=st.floats(0.5, 100.0),
)
def test_each_is_a_valid_band_around_its_own_frequency(
    hz: list[float], deviation: float, duration: float
) -> None:
    usable = [f for f in hz if f > 1 / duration]
    if any(abs(a - b) < 0.01 for a in usable for b in usable if a != b):
        return
    bands = suggested_bands(usable, [deviation] * len(usable), duration, 30.0)
    for f, (low, high) in zip(usable, bands, strict=True):
        assert check_band((low, high), 30.0) == (low, high)
        assert low <= f <= high
        assert [g for g in usable if low < g < high] == [f]
