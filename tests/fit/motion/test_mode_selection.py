"""Peaks are counted once, modes that hold noise alone are empty, and what a frequency may be besides is said."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fit.motion.scenes import of_amplitudes
from tg4mm.capture import ImageStack
from tg4mm.core.choices import Kind
from tg4mm.fit.motion.mode_selection import frequency_notes, peaks, worth_keeping
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import Observations, PosedFrames


def observed(fps, n_frames=90):
    frames = PosedFrames("cam", np.eye(4), np.eye(3), np.arange(n_frames), np.arange(n_frames) / fps)
    pictures = ImageStack(np.zeros((n_frames, 2, 2, 4), np.uint8))
    return Observations(Kind.tripod, "synchronous", [frames], pictures, fps, n_frames, True)


def moving(hz, size):
    displacement = np.array(size)[:, None, None] * np.ones((1, 5, 3), np.complex64)
    return ModalMotion.of_phasors(np.array(hz), displacement.astype(np.complex64), 0 * displacement, 30.0, 90)


def test_peaks_are_by_falling_strength_and_no_weaker_than_three_percent():
    motion = moving([0.2, 3.4, 7.0, 9.0], [50.0, 1.0, 2.0, 0.05])
    np.testing.assert_allclose(peaks(motion, 0.67), [7.0, 3.4])


def test_what_a_region_showed_is_a_peak_however_weak_in_the_mean():
    motion = moving([3.4, 7.0, 9.0, 9.4], [1.0, 2.0, 0.01, 0.01])
    np.testing.assert_allclose(peaks(motion, 0.67, None, [9.02]), [7.0, 3.4, 9.0])
    np.testing.assert_allclose(peaks(motion, 0.67, None, [8.2]), [7.0, 3.4])  # no mode is there


def test_the_flank_of_a_drift_has_no_peak_and_what_stands_on_it_has_one():
    """Bins of a record of 3 s, falling from the drift of the first one."""
    hz = np.arange(1, 40) / 3
    size = 3 / hz
    size[20] = 4.0
    np.testing.assert_allclose(peaks(moving(hz.tolist(), size.tolist()), 2 / 3), [hz[20]])


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_that_is_spread_over_frequencies_has_no_peak(seed):
    """A random walk of 5 points, 30 s long, seen at 15 frames a second: each bin falls where chance puts it."""
    hz = np.arange(1, 200) / 30
    rng = np.random.default_rng(seed)
    size = np.sqrt((rng.normal(size=(len(hz), 5)) ** 2).mean(1)) / hz
    assert not len(peaks(moving(hz.tolist(), size.tolist()), 2 / 30))
    size[33] *= 8
    np.testing.assert_allclose(peaks(moving(hz.tolist(), size.tolist()), 2 / 30), [hz[33]])


@pytest.mark.parametrize(("fps", "hz", "mains"), [(30.0, 10.0, 100), (29.97, 10.09, 100), (25.0, 5.0, 120)])
def test_where_flickering_light_would_appear_it_is_said(fps, hz, mains):
    (line,) = frequency_notes([hz], observed(fps))
    assert f"flickers at {mains} Hz" in line
    assert "\n" not in line
    assert not frequency_notes([hz + 1], observed(fps))


def test_close_to_half_the_frame_rate_the_other_frequency_is_said():
    (line,) = frequency_notes([13.0], observed(30.0))
    assert "a vibration of 17 Hz would look the same" in line
    assert not frequency_notes([11.0], observed(30.0))


def test_where_most_modes_are_noise_a_peak_stands_out_of_them():
    hz = [1.0 + k / 3 for k in range(40)]
    noise = 0.008 + 0.02 * np.random.default_rng(0).random(40)
    noise[:2] = 0.045, 0.04  # the largest of them
    strength = noise.tolist()
    strength[7], strength[20] = 1.0, 0.2
    np.testing.assert_allclose(peaks(moving(hz, strength), 0.67), [hz[7], hz[20]])


def test_of_few_modes_a_peak_has_more_power_than_all_noise():
    """Twelve frames make six modes, which are no sample of the noise."""
    hz = [2.5, 5.0, 7.5, 10.0, 12.5]
    motion = moving(hz, [0.5, 0.6, 0.5, 0.9, 0.4])
    noise = np.full(5, np.sqrt(sum(3 * a**2 / 2 for a in (0.5, 0.6, 0.5, 0.9, 0.4))), np.float32)
    assert not len(peaks(motion, 2.0, noise))
    np.testing.assert_allclose(peaks(motion, 2.0, noise / 10)[0], 10.0)
    strong = moving(hz, [0.5, 0.6, 5.0, 0.9, 0.4])
    np.testing.assert_allclose(peaks(strong, 2.0, noise), [7.5])


@pytest.mark.parametrize(
    ("hz", "is_said"), [(7.5, True), (7.6, True), (15.0, True), (8.0, False), (3.4, False)]
)
def test_what_the_compression_repeats_is_said(hz, is_said):
    """Frames of a period of four at 30 Hz; two seconds, so that frequencies are half a hertz apart."""
    compressed = replace(observed(30.0, 60), codec_period=4)
    said = "repetition of the video's compression"
    assert any(said in note for note in frequency_notes([hz], compressed)) == is_said
    assert not any(said in note for note in frequency_notes([hz], observed(30.0, 60)))


def test_modes_under_the_noise_are_empty():
    motion = of_amplitudes([1e-19, 1.0, 0.001, 0.3], [1.0, 2.0, 3.0, 4.0])
    assert worth_keeping(motion, np.full(50, 0.01)).tolist() == [False, True, False, True]
    assert worth_keeping(motion, np.full(50, 1e-4)).tolist() == [False, True, True, True]


def test_weak_modes_that_add_up_stay():
    """A transient is spread over many bins: each is below the noise, all of them are not."""
    motion = of_amplitudes([1.0, *[0.1] * 8], list(range(1, 10)))
    kept = worth_keeping(motion, np.full(50, 0.15))
    assert kept[0]
    dropped = (0.1**2 / 2) * (~kept).sum()
    assert 0 < dropped <= 0.15**2 < dropped + 0.1**2 / 2
    stray = np.full(200, 0.15)
    stray[0] = 100.0  # seen by no camera, perhaps
    motion = of_amplitudes([1.0, *[0.1] * 8], list(range(1, 10)), 200)
    assert worth_keeping(motion, stray).tolist() == kept.tolist()


def test_without_known_noise_only_rounding_is_dropped():
    motion = of_amplitudes([1.0, 0.01, 1e-8], [1.0, 2.0, 3.0])
    assert worth_keeping(motion, None).tolist() == [True, True, False]


def test_zero_hertz_stays_and_stillness_is_empty():
    assert worth_keeping(of_amplitudes([0.0, 1.0], [0.0, 5.0]), np.full(50, 0.1)).tolist() == [True, True]
    assert worth_keeping(of_amplitudes([0.0], [5.0]), np.full(50, 0.1)).tolist() == [False]


def test_half_the_frame_rate_is_no_frequency_since_no_band_can_hold_it():
    motion = of_amplitudes([0.1, 1.0, 3.0], [5.0, 7.0, 15.0])
    assert peaks(motion, 1.0).tolist() == [7.0, 5.0]
