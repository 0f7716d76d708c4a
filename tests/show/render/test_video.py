"""The mp4 holds the frames that were asked for, at the size and rate that were asked for."""

import imageio_ffmpeg
import numpy as np
import pytest

from tg4mm.core.errors import RunError
from tg4mm.core.pictures.frames import write_png
from tg4mm.show.render.video import even_size, loops_to_last, video_of_files, write_mp4


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


def test_colours_survive(tmp_path):
    colour = np.array([200, 60, 30], np.uint8)
    write_mp4(tmp_path / "a.mp4", [np.broadcast_to(colour, (32, 32, 3))] * 2, fps=10)
    _, frames = read_mp4(tmp_path / "a.mp4")
    np.testing.assert_allclose(frames[0].mean(axis=(0, 1)), colour, atol=6)


def test_odd_sizes_become_even_by_repeating_the_border(tmp_path):
    frame = np.random.default_rng(0).integers(0, 256, (15, 17, 3), dtype=np.uint8)
    np.testing.assert_array_equal(even_size(frame)[:15, :17], frame)
    np.testing.assert_array_equal(even_size(frame)[15, :17], frame[14])
    write_mp4(tmp_path / "a.mp4", [frame] * 2, fps=10)
    assert read_mp4(tmp_path / "a.mp4")[0]["size"] == (18, 16)


def test_scale_enlarges(tmp_path):
    write_mp4(tmp_path / "a.mp4", [flat(9)] * 2, fps=10, scale=3)
    assert read_mp4(tmp_path / "a.mp4")[0]["size"] == (96, 72)


def test_repeats_last_long_enough_and_not_longer():
    assert loops_to_last(30, 30.0, 4.0) == 4
    assert loops_to_last(31, 30.0, 4.0) == 4
    assert loops_to_last(29, 30.0, 4.0) == 5
    assert loops_to_last(300, 30.0, 4.0) == 1


def test_a_video_of_files_runs_for_some_seconds(tmp_path):
    paths = [tmp_path / f"{i}.png" for i in range(3)]
    for i, path in enumerate(paths):
        write_png(path, flat(60 * i))
    video_of_files(tmp_path / "a.mp4", paths, fps=6.0)
    meta, frames = read_mp4(tmp_path / "a.mp4")
    assert len(frames) == 24
    assert meta["duration"] == pytest.approx(4.0, abs=0.2)


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
