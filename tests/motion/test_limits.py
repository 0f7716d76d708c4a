"""What a capture cannot tell of a frequency is said in one line each; peaks are counted once."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.capture import ImageStack
from tg4mm.capture.pictures import pictures_of
from tg4mm.motion.mode_selection import frequency_notes, peaks
from tg4mm.motion.modes import ModalMotion
from tg4mm.motion.observations import Observations, PosedFrames


def observed(fps: float, n_frames: int = 90) -> Observations:
    frames = PosedFrames("cam", np.eye(4), np.eye(3), np.arange(n_frames), np.arange(n_frames) / fps)
    pictures = pictures_of(ImageStack(np.zeros((n_frames, 2, 2, 4), np.uint8)))
    return Observations("tripod", "synchronous", [frames], pictures, fps, n_frames, True)


def moving(hz: list[float], size: list[float]) -> ModalMotion:
    displacement = np.array(size)[:, None, None] * np.ones((1, 5, 3), np.complex64)
    return ModalMotion(np.array(hz), displacement.astype(np.complex64), 0 * displacement, 30.0, 90)


def test_peaks_are_by_falling_strength_and_no_weaker_than_three_percent() -> None:
    motion = moving([0.2, 3.4, 7.0, 9.0], [50.0, 1.0, 2.0, 0.05])
    np.testing.assert_allclose(peaks(motion, 0.67), [7.0, 3.4])


def test_a_frequency_and_the_bins_beside_it_are_one_peak() -> None:
    np.testing.assert_allclose(peaks(moving([3.1, 3.4, 3.6, 6.8], [0.3, 1.0, 0.2, 0.5]), 0.67), [3.4, 6.8])


def test_the_flank_of_a_drift_has_no_peak_and_what_stands_on_it_has_one() -> None:
    """Bins of a record of 3 s, falling from the drift of the first one."""
    hz = np.arange(1, 40) / 3
    size = 3 / hz
    size[20] = 4.0
    np.testing.assert_allclose(peaks(moving(hz.tolist(), size.tolist()), 2 / 3), [hz[20]])


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_that_is_spread_over_frequencies_has_no_peak(seed: int) -> None:
    """A random walk of 5 points, 30 s long, seen at 15 frames a second: each bin falls where chance puts it."""
    hz = np.arange(1, 200) / 30
    rng = np.random.default_rng(seed)
    size = np.sqrt((rng.normal(size=(len(hz), 5)) ** 2).mean(1)) / hz
    assert not len(peaks(moving(hz.tolist(), size.tolist()), 2 / 30))
    size[33] *= 8
    np.testing.assert_allclose(peaks(moving(hz.tolist(), size.tolist()), 2 / 30), [hz[33]])


def test_nothing_that_moves_has_no_peak() -> None:
    assert not len(peaks(moving([], []), 0.67))


@pytest.mark.parametrize(("fps", "hz", "mains"), [(30.0, 10.0, 100), (29.97, 10.09, 100), (25.0, 5.0, 120)])
def test_where_flickering_light_would_appear_it_is_said(fps: float, hz: float, mains: int) -> None:
    (line,) = frequency_notes([hz], observed(fps))
    assert f"flickers at {mains} Hz" in line
    assert "\n" not in line
    assert not frequency_notes([hz + 1], observed(fps))


def test_close_to_half_the_frame_rate_the_other_frequency_is_said() -> None:
    (line,) = frequency_notes([13.0], observed(30.0))
    assert "a vibration of 17 Hz would look the same" in line
    assert not frequency_notes([11.0], observed(30.0))


def test_where_most_modes_are_noise_a_peak_stands_out_of_them() -> None:
    hz = [1.0 + k / 3 for k in range(40)]
    noise = 0.008 + 0.02 * np.random.default_rng(0).random(40)
    noise[:2] = 0.045, 0.04  # the largest of them
    strength = noise.tolist()
    strength[7], strength[20] = 1.0, 0.2
    np.testing.assert_allclose(peaks(moving(hz, strength), 0.67), [hz[7], hz[20]])
