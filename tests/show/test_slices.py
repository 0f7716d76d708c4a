"""Space-time slices, difference maps and spectra of a synthetic sinusoid."""

import numpy as np
import pytest

from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.slices import amplitude_spectrum, difference_maps, most_moving_line, space_time_slice

T, H, W, FPS, FREQ = 30, 12, 64, 30.0, 3.0
ROW = 7


@pytest.fixture
def video() -> np.ndarray:
    """A soft vertical edge in rows 6 to 8, strongest in row 7, that swings at 3 Hz by 4 pixels."""
    x, t = np.arange(W) + 0.5, np.arange(T)
    centre = 32 + 4 * np.sin(2 * np.pi * FREQ * t / FPS)
    edge = 1 / (1 + np.exp(-(x - centre[:, None]) / 2))
    video = np.full((T, H, W, 3), 0.25)
    for row, strength in ((6, 0.2), (ROW, 0.7), (8, 0.2)):
        video[:, row] = 0.25 + strength * edge[..., None]
    return video


def test_a_row_slice_shows_the_sinusoid_and_its_frequency(video) -> None:
    picture = space_time_slice(video, "row", ROW)
    assert picture.shape == (T, W, 3)
    np.testing.assert_array_equal(picture[5], video[5, ROW])
    position = -(picture[..., 0] - 0.25).sum(1) / 0.7  # the edge's place, up to a constant
    amplitude = np.abs(np.fft.rfft(position - position.mean())) * 2 / T
    frequencies = np.fft.rfftfreq(T, 1 / FPS)
    assert frequencies[amplitude.argmax()] == pytest.approx(FREQ)
    assert amplitude.max() == pytest.approx(4.0, rel=0.01)


def test_a_column_slice_has_time_to_the_right(video) -> None:
    picture = space_time_slice(video, "column", 32)
    assert picture.shape == (H, T, 3)
    np.testing.assert_array_equal(picture[:, 5], video[5, :, 32])


def test_a_slice_is_a_copy(video) -> None:
    space_time_slice(video, "row", ROW)[:] = 0
    assert video[:, ROW].min() > 0.2


def test_lines_outside_the_video_are_refused(video) -> None:
    with pytest.raises(ValueError, match="row 12 is outside the video's 12 rows"):
        space_time_slice(video, "row", H)
    with pytest.raises(ValueError, match="column -1 is outside"):
        space_time_slice(video, "column", -1)
    with pytest.raises(ValueError, match="'diagonal'"):
        space_time_slice(video, "diagonal", 0)
    with pytest.raises(ValueError, match=r"\(12, 64\)"):
        space_time_slice(video[0, ..., 0], "row", 0)


def test_the_most_moving_line_is_found(video) -> None:
    assert most_moving_line(video) == ("row", ROW)
    axis, column = most_moving_line(video, "column")
    assert axis == "column"
    assert abs(column - 31.5) <= 1.5
    assert most_moving_line(np.swapaxes(video, 1, 2)) == ("column", ROW)
    assert most_moving_line(np.zeros((3, 8, 6, 3))) == ("row", 4)


def test_difference_maps_are_equation_17(video) -> None:
    maps, scale = difference_maps(video, 6)
    assert maps.shape == (6, H, W)
    np.testing.assert_allclose(maps[2], np.abs(video[3] - video[2]).mean(-1))
    assert scale == maps.max() > 0
    assert len(difference_maps(video)[0]) == T - 1


def test_differences_of_bytes_do_not_wrap_around() -> None:
    video = np.array([10, 0, 255], np.uint8)[:, None, None] * np.ones((1, 2, 2), np.uint8)
    maps, scale = difference_maps(video)
    np.testing.assert_array_equal(maps[:, 0, 0], [10, 255])
    assert scale == 255


@pytest.mark.parametrize("count", [0, T])
def test_more_maps_than_frames_are_refused(video, count) -> None:
    with pytest.raises(ValueError, match=f"{count} difference maps asked of 30 frames, expected 1 to 29"):
        difference_maps(video, count)


def test_the_spectrum_is_the_weighted_mean_amplitude() -> None:
    displacement = np.zeros((2, 3, 3), np.complex64)
    displacement[0, 0] = [0, 3e-3j, 4e-3]  # length 5e-3
    displacement[1] = 1e-3
    motion = ModalMotion(np.array([5.0, 3.0]), displacement, np.zeros_like(displacement), FPS, T)
    frequencies, amplitude = amplitude_spectrum(motion, np.array([1.0, 3.0, 0.0]))
    np.testing.assert_array_equal(frequencies, [3.0, 5.0])
    np.testing.assert_allclose(amplitude, [np.sqrt(3) * 1e-3, 5e-3 / 4], rtol=1e-6)
    np.testing.assert_allclose(amplitude_spectrum(motion)[1][1], 5e-3 / 3, rtol=1e-6)


def test_weights_that_do_not_fit_are_refused() -> None:
    motion = ModalMotion(
        np.array([3.0]), np.zeros((1, 3, 3), np.complex64), np.zeros((1, 3, 3), np.complex64), FPS, T
    )
    with pytest.raises(ValueError, match=r"\(2,\), expected \(3,\)"):
        amplitude_spectrum(motion, np.ones(2))
    with pytest.raises(ValueError, match="sum is 0"):
        amplitude_spectrum(motion, np.zeros(3))
