"""A camera's distinct pictures, strip by strip."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.test_differences import moving_pictures
from tests.space.scenes import capture_of
from tg4mm.capture import ImageStack
from tg4mm.capture.pictures import StackedPictures
from tg4mm.errors import CaptureError
from tg4mm.motion.pictures import video as module
from tg4mm.motion.pictures.video import fixed_cameras, video_of


class TestFixedCameras:
    def test_rows_are_in_order_of_time(self) -> None:
        data, ids, times = moving_pictures(2, 4)
        capture, _ = capture_of(ids, times, data)
        cameras = fixed_cameras(capture)
        np.testing.assert_array_equal([c.rows for c in cameras], [[0, 2, 4, 6], [1, 3, 5, 7]])
        assert [c.viewmat[0, 3] for c in cameras] == [0.0, 1.0]

    def test_shuffled_rows_are_sorted(self) -> None:
        data, _, _ = moving_pictures(1, 4)
        capture, _ = capture_of([0, 0, 0, 0], [2, 0, 3, 1], data)
        np.testing.assert_array_equal(fixed_cameras(capture)[0].rows, [1, 3, 0, 2])

    def test_cameras_that_miss_or_double_a_timestep_are_left_out(self) -> None:
        data, _, _ = moving_pictures(1, 9)
        ids, times = [0, 1, 2, 0, 1, 2, 0, 2, 2], [0, 0, 0, 1, 1, 1, 2, 2, 2]
        cameras = fixed_cameras(capture_of(ids, times, data)[0])
        assert [list(c.rows) for c in cameras] == [[0, 3, 6]]

    def test_none_is_an_error_with_the_path_and_the_number_of_timesteps(self) -> None:
        data, _, _ = moving_pictures(1, 4)
        capture, _ = capture_of([0, 1, 2, 3], [0, 1, 2, 3], data)
        with pytest.raises(
            CaptureError, match=r"\A/data: no camera has one image at each of the 4 timesteps[^\n]*\Z"
        ):
            fixed_cameras(capture)


class TestVideo:
    @pytest.fixture
    def pictures(self) -> np.ndarray:
        """Two cameras, six timesteps of 4 × 5 pixels; of camera 1 the states 0 1 0 2 1 1 repeat."""
        rng = np.random.default_rng(7)
        data = rng.integers(0, 256, (2, 6, 4, 5, 4)).astype(np.uint8)
        data[1] = data[1, [0, 1, 0, 2, 1, 1]]
        return data.reshape(12, 4, 5, 4)

    def video(self, pictures: np.ndarray, camera: int) -> module.Video:
        capture, images = capture_of([0] * 6 + [1] * 6, [*range(6), *range(6)], pictures)
        return video_of(StackedPictures(images), fixed_cameras(capture)[camera])

    def test_equal_pictures_are_one(self, pictures: np.ndarray) -> None:
        video = self.video(pictures, 1)
        np.testing.assert_array_equal(video.state, [0, 1, 0, 2, 1, 1])
        np.testing.assert_array_equal(video.rows, [6, 7, 9])
        np.testing.assert_allclose(video.share, [2 / 6, 3 / 6, 1 / 6])

    def test_pictures_that_differ_in_one_bit_are_two(self, pictures: np.ndarray) -> None:
        pictures[8, 3, 4, 3] ^= 1  # the first picture's second showing
        np.testing.assert_array_equal(self.video(pictures, 1).state, [0, 1, 2, 3, 1, 1])

    @pytest.mark.parametrize("opaque", [False, True])
    @pytest.mark.parametrize("values", [1, 95, 1 << 20])  # a row at a time, two rows, all
    def test_strips_are_the_pictures_over_white_less_their_mean(
        self, pictures: np.ndarray, values: int, opaque: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(module, "STRIP_VALUES", values)
        if opaque:
            pictures[..., 3] = 255
        video = self.video(pictures, 1)
        seen = np.stack([ImageStack(pictures).rgb(i) for i in range(6, 12)]).astype(float)
        strips = list(video.strips())
        assert len(strips) == {1: 4, 95: 2, 1 << 20: 1}[values]
        found = np.concatenate([strip for *_, strip in strips], 1)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found[video.state], seen - seen.mean(0), atol=2e-7)
        mean = np.concatenate([mean for _, mean, _ in strips])
        np.testing.assert_allclose(mean, seen.mean(0), atol=2e-7)
        covered = np.concatenate([np.arange(rows.start, rows.stop) for rows, *_ in strips])
        np.testing.assert_array_equal(covered, np.arange(4))

    def test_sixteen_bits(self) -> None:
        data = np.random.default_rng(0).integers(0, 65536, (3, 2, 2, 4)).astype(np.uint16)
        capture, images = capture_of([0] * 3, [0, 1, 2], data)
        ((_, _, found),) = video_of(StackedPictures(images), fixed_cameras(capture)[0]).strips()
        seen = np.stack([images.rgb(i) for i in range(3)]).astype(float)
        np.testing.assert_allclose(found, seen - seen.mean(0), atol=2e-7)
