"""Pictures come back as they were written; what a kill leaves behind is seen as incomplete."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tg4mm.core.errors import RunError
from tg4mm.core.pictures.frames import is_complete_png, png_bytes, read_png, to_bytes, write_png


@given(st.integers(1, 9), st.integers(1, 9), st.sampled_from([3, 4]), st.integers(0, 2**32 - 1))
def test_png_bytes_round_trip(height, width, channels, seed):
    image = np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)
    with Image.open(io.BytesIO(png_bytes(image))) as back:
        np.testing.assert_array_equal(np.asarray(back), image)


def test_floats_are_rounded_to_the_nearest_of_256_values():
    np.testing.assert_array_equal(
        to_bytes(np.array([-1.0, 0.0, 0.4 / 255, 0.6 / 255, 1.0, 2.0])), [0, 0, 0, 1, 255, 255]
    )


def test_transparency_is_read_over_white(tmp_path):
    write_png(tmp_path / "a.png", np.array([[[255, 0, 0, 0], [255, 0, 0, 255], [0, 0, 0, 51]]], np.uint8))
    np.testing.assert_array_equal(read_png(tmp_path / "a.png"), [[[255] * 3, [255, 0, 0], [204] * 3]])


def test_completeness_needs_the_size_and_the_end(tmp_path):
    path = tmp_path / "deep" / "a.png"
    write_png(path, np.zeros((5, 7, 3)))
    assert is_complete_png(path, 7, 5)
    assert not is_complete_png(path, 5, 7)
    whole = path.read_bytes()
    for length in (0, 7, 30, len(whole) - 1):
        path.write_bytes(whole[:length])
        assert not is_complete_png(path, 7, 5)
    assert not is_complete_png(tmp_path / "none.png", 7, 5)
    assert not is_complete_png(tmp_path, 7, 5)


def test_a_file_that_is_no_picture_is_named(tmp_path):
    (tmp_path / "a.png").write_bytes(b"not a picture")
    with pytest.raises(RunError, match=r"a\.png"):
        read_png(tmp_path / "a.png")


def test_nothing_is_left_beside_a_written_picture(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((2, 2, 3)))
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
