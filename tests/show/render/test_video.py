"""Pictures and videos hold what was written; what a kill leaves behind is seen as incomplete."""

import imageio_ffmpeg
import numpy as np
import pytest

from tg4mm.core.errors import RunError
from tg4mm.core.pictures import png
from tg4mm.core.pictures.decode import write_png
from tg4mm.show.render.video import write_mp4


def read_mp4(path):
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    return meta, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


def flat(level, height=24, width=32):
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


def test_completeness_needs_the_size_and_the_end(tmp_path):
    path = tmp_path / "deep" / "a.png"
    write_png(path, np.zeros((5, 7, 3)))
    assert png.complete(path, 7, 5)
    assert not png.complete(path, 5, 7)
    whole = path.read_bytes()
    for length in (0, 7, 30, len(whole) - 1):
        path.write_bytes(whole[:length])
        assert not png.complete(path, 7, 5)
    assert not png.complete(tmp_path / "none.png", 7, 5)
    assert not png.complete(tmp_path, 7, 5)
