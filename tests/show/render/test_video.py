"""Pictures and videos hold what was written; what a kill leaves behind is seen as incomplete."""

from __future__ import annotations

import io

import imageio_ffmpeg
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tg4mm.core.errors import RunError
from tg4mm.core.pictures.frames import is_complete_png, png_bytes, read_png, write_png
from tg4mm.show.render.video import even_size, write_mp4


def read_mp4(path):
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    return meta, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


def flat(level: int, height: int = 24, width: int = 32) -> np.ndarray:
    return np.full((height, width, 3), level, np.uint8)


def test_mp4_has_the_frames_size_and_rate(tmp_path):
    path = tmp_path / "a.mp4"
    levels = [40, 90, 140, 190, 240]
    write_mp4(path, [flat(level) for level in levels], fps=12.5, loops=3)
    meta, frames = read_mp4(path)
    assert meta["size"] == (32, 24)
    assert meta["fps"] == pytest.approx(12.5)
    assert meta["codec"] == "h264"
    assert "yuv420p" in meta["pix_fmt"]
    assert len(frames) == 15
    np.testing.assert_allclose([frame.mean() for frame in frames], levels * 3, atol=4)


def test_odd_sizes_become_even_by_repeating_the_border(tmp_path):
    frame = np.random.default_rng(0).integers(0, 256, (15, 17, 3), dtype=np.uint8)
    np.testing.assert_array_equal(even_size(frame)[:15, :17], frame)
    np.testing.assert_array_equal(even_size(frame)[15, :17], frame[14])
    write_mp4(tmp_path / "a.mp4", [frame] * 2, fps=10)
    assert read_mp4(tmp_path / "a.mp4")[0]["size"] == (18, 16)


@pytest.mark.parametrize(
    ("frames", "fps", "message"),
    [
        ([], 30.0, "no frames"),
        ([flat(0)], 0.0, "a video of 0 pictures a second"),
        ([flat(0)], float("nan"), "a video of nan pictures a second"),
        ([flat(0), flat(0, 26)], 30.0, "different sizes"),
    ],
)
def test_bad_requests_leave_no_file(tmp_path, frames, fps, message):
    with pytest.raises(RunError, match=message):
        write_mp4(tmp_path / "a.mp4", frames, fps)
    assert not list(tmp_path.iterdir())


@given(st.integers(1, 9), st.integers(1, 9), st.sampled_from([3, 4]), st.integers(0, 2**32 - 1))
def test_png_bytes_round_trip(height, width, channels, seed):
    image = np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)
    with Image.open(io.BytesIO(png_bytes(image))) as back:
        np.testing.assert_array_equal(np.asarray(back), image)


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
