"""Videos frame by frame: exact times, upright pictures, and what is wrong with a file said in one line."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.capture.sfm.videos import cut_off, still, texture, write_video
from tg4mm.capture.sfm.clip import Clip, Window, clip_frames, frame_rate, regular_times, uneven_steps
from tg4mm.capture.video import video_frames, video_info
from tg4mm.core.errors import CaptureError

NTSC = Fraction(30000, 1001)


def test_ntsc_is_taken_exactly(tmp_path):
    path = write_video(tmp_path / "a.mp4", still(12), NTSC)
    times = [frame.time for frame in video_frames(path)]
    info = video_info(path)
    assert times == [k / NTSC for k in range(12)]
    assert frame_rate(path, times, info.rates, info.tick) == NTSC
    assert info.duration_s == pytest.approx(12 * 1001 / 30000)


@pytest.mark.parametrize(("degrees", "turns"), [(90, 1), (180, 2), (-90, 3)])
def test_a_rotation_in_the_container_is_obeyed(tmp_path, degrees, turns):
    picture = texture().astype(np.uint8)
    path = write_video(tmp_path / "a.mp4", [picture] * 3, rotation=degrees)
    expected = np.rot90(picture, turns)
    found = next(video_frames(path)).pixels
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).mean() < 6
    assert np.abs(found.astype(int) - np.rot90(expected, 2)).mean() > 10


def test_a_window_leaves_out_the_rest_and_keeps_the_times(tmp_path):
    path = write_video(tmp_path / "a.mp4", still(30), 30)
    frames = list(clip_frames(Clip("a", path), Window(0.5, 0.8)))
    assert [frame.time for frame in frames] == [Fraction(k, 30) for k in range(15, 24)]
    assert [frame.index for frame in frames] == list(range(9))


def test_milliseconds_of_a_container_become_the_regular_clock_they_were(tmp_path):
    """Matroska keeps whole milliseconds: 33, 67, 100 …"""
    path = write_video(tmp_path / "a.mkv", still(20), NTSC)
    times, info = [frame.time for frame in video_frames(path)], video_info(path)
    assert info.tick == Fraction(1, 1000)
    assert times != [k / NTSC for k in range(20)]
    fps = frame_rate(path, times, info.rates, info.tick)
    assert regular_times(times, fps, info.tick) == [k / NTSC for k in range(20)]


def test_dropped_frames_keep_their_gap(tmp_path):
    kept = [0, 1, 2, 3, 5, 6, 7, 8, 9, 12, 13, 14]
    path = write_video(tmp_path / "a.mp4", still(12), 30, times=kept)
    times, info = [frame.time for frame in video_frames(path)], video_info(path)
    fps = frame_rate(path, times, info.rates, info.tick)
    assert times == [Fraction(k, 30) for k in kept]
    assert fps == 30
    assert regular_times(times, fps, info.tick) == times
    steps = uneven_steps(np.array([float(time) for time in times]))
    assert steps == (pytest.approx(1 / 30), pytest.approx(0.1))


def test_stamps_that_do_not_rise_are_refused():
    with pytest.raises(CaptureError, match=r"a: its time stamps do not rise, which leaves no frame rate"):
        frame_rate(Path("a"), [Fraction(0)] * 5, ())


class TestDamage:
    def test_one_that_was_cut_off_before_its_index(self, tmp_path):
        """A phone writes the index of its frames when it stops: a copy that breaks off before has none."""
        whole = write_video(tmp_path / "a.mp4", still(20))
        moved = tmp_path / "b.mp4"
        data = whole.read_bytes()
        moved.write_bytes(data[: data.index(b"moov") - 4])
        with pytest.raises(CaptureError, match=r"cut off before its index; copy it from the camera again$"):
            video_info(moved)

    def test_sound_alone(self, tmp_path):
        import av

        path = tmp_path / "a.mp4"
        with av.open(str(path), "w") as container:
            stream = container.add_stream("aac", rate=48000)
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 4800), np.float32), "fltp", "mono")
            frame.sample_rate = 48000
            container.mux(stream.encode(frame))
            container.mux(stream.encode())
        with pytest.raises(CaptureError, match=r"a\.mp4: holds no video that can be decoded"):
            video_info(path)

    @pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
    def test_a_cut_off_one_names_the_second(self, tmp_path, suffix):
        path = cut_off(write_video(tmp_path / f"a{suffix}", still(60)), 0.5)
        with pytest.raises(
            CaptureError, match=r"is damaged or cut off: decoding stops at [01]\.\d\d s of 2\.00 s"
        ):
            list(video_frames(path))

    def test_what_comes_before_can_be_taken_as_it_says(self, tmp_path):
        path = cut_off(write_video(tmp_path / "a.mp4", still(60)), 0.5)
        with pytest.raises(CaptureError) as caught:
            list(video_frames(path))
        until = float(str(caught.value).split("--until ")[1].split(",")[0])
        frames = list(video_frames(path, stop_s=until))
        assert 15 <= len(frames) < 45
