"""Modes that hold nothing but noise are told from those that hold motion."""

from __future__ import annotations

import numpy as np

from tests.fit.motion.scenes import of_amplitudes
from tg4mm.fit.motion.mode_selection import peaks, worth_keeping


def test_modes_under_the_noise_are_empty() -> None:
    motion = of_amplitudes([1e-19, 1.0, 0.001, 0.3], [1.0, 2.0, 3.0, 4.0])
    assert worth_keeping(motion, np.full(50, 0.01)).tolist() == [False, True, False, True]
    assert worth_keeping(motion, np.full(50, 1e-4)).tolist() == [False, True, True, True]


def test_weak_modes_that_add_up_stay() -> None:
    """A transient is spread over many bins: each is below the noise, all of them are not."""
    motion = of_amplitudes([1.0, *[0.1] * 8], list(range(1, 10)))
    kept = worth_keeping(motion, np.full(50, 0.15))
    assert kept[0]
    dropped = (0.1**2 / 2) * (~kept).sum()
    assert 0 < dropped <= 0.15**2 < dropped + 0.1**2 / 2
    stray = np.full(200, 0.15)
    stray[0] = 100.0  # seen by no camera, perhaps
    assert (
        worth_keeping(of_amplitudes([1.0, *[0.1] * 8], list(range(1, 10)), 200), stray).tolist()
        == kept.tolist()
    )


def test_without_known_noise_only_rounding_is_dropped() -> None:
    motion = of_amplitudes([1.0, 0.01, 1e-8], [1.0, 2.0, 3.0])
    assert worth_keeping(motion, None).tolist() == [True, True, False]


def test_zero_hertz_stays_and_stillness_is_empty() -> None:
    assert worth_keeping(of_amplitudes([0.0, 1.0], [0.0, 5.0]), np.full(50, 0.1)).tolist() == [True, True]
    assert worth_keeping(of_amplitudes([0.0], [5.0]), np.full(50, 0.1)).tolist() == [False]


def test_half_the_frame_rate_is_no_frequency_since_no_band_can_hold_it() -> None:
    motion = of_amplitudes([0.1, 1.0, 3.0], [5.0, 7.0, 15.0])
    assert peaks(motion, 1.0).tolist() == [7.0, 5.0]
