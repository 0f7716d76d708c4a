"""Videos frame by frame: exact times, upright pictures, and what is wrong with a file said in one line."""

import logging
import math
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from tests.capture.sfm.videos import (
    as_shown,
    cut_off,
    edited,
    encoded,
    looked,
    still,
    texture,
    write_resized,
    write_video,
)
from tg4mm.capture.frames import picture as frame_picture
from tg4mm.capture.look.recording import read_recording
from tg4mm.capture.sfm.clip import Clip, TimeWindow, clip_frames, frame_rate, regular_times, uneven_steps
from tg4mm.capture.video import grey_frames, is_turned, video_frames, video_info
from tg4mm.core.errors import CaptureError

NTSC = Fraction(30000, 1001)
_TURNED = {
    (1, 0, 0, 1): lambda p: p,
    (-1, 0, 0, 1): np.fliplr,
    (1, 0, 0, -1): np.flipud,
    (-1, 0, 0, -1): lambda p: np.rot90(p, 2),
    (0, 1, -1, 0): lambda p: np.rot90(p, -1),  # 90 degrees clockwise, as phones write that are held upright
    (0, -1, 1, 0): np.rot90,
    (0, 1, 1, 0): lambda p: p.swapaxes(0, 1),
    (0, -1, -1, 0): lambda p: np.rot90(p, 2).swapaxes(0, 1),
    (1, 0.02, 0, 1): lambda p: p,
}


def test_ntsc_is_taken_exactly(tmp_path):
    path = write_video(tmp_path / "a.mp4", still(12), NTSC)
    times = [frame.time for frame in video_frames(path)]
    info = video_info(path)
    assert times == [k / NTSC for k in range(12)]
    assert frame_rate(path, times, info.rates, info.tick) == NTSC
    assert info.duration_s == pytest.approx(12 * 1001 / 30000)


@pytest.mark.parametrize("matrix", _TURNED)
def test_the_containers_display_matrix_is_obeyed(tmp_path, matrix):
    picture = texture().astype(np.uint8)
    path = as_shown(write_video(tmp_path / "a.mp4", [picture] * 3), matrix)
    expected = _TURNED[matrix](picture)
    found = next(video_frames(path)).pixels
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).mean() < 6
    assert np.array_equal(next(grey_frames(path)).grey.shape, expected.shape[:2])
    assert is_turned(path) == (matrix[0] != 1 or matrix[3] != 1)
    np.testing.assert_array_equal(frame_picture(Path(f"{path}#0"))[..., :3], found)


@pytest.mark.parametrize("default", [0, 1])
def test_of_several_streams_the_default_one_is_taken_else_the_largest(tmp_path, default):
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        small, large = (container.add_stream("mjpeg", rate=rate) for rate in (10, 30))
        for stream, size in ((small, (64, 48)), (large, (160, 120))):
            stream.width, stream.height, stream.pix_fmt = *size, "yuvj420p"
            stream.disposition = type(stream.disposition)(default * (stream is small))
        for k in range(12):
            for stream in (small, large):
                frame = av.VideoFrame(stream.width, stream.height, "yuvj420p")
                frame.pts, frame.time_base = k, Fraction(1, 10 if stream is small else 30)
                container.mux(stream.encode(frame))
    expected = (48, 64, 3) if default else (120, 160, 3)
    assert next(video_frames(path)).pixels.shape == expected
    assert frame_picture(Path(f"{path}#3")).shape[:2] == expected[:2]
    assert video_info(path).rates[0] == pytest.approx(10 if default else 30, rel=0.01)


def test_a_size_that_changes_is_said_with_the_part_that_can_be_used(tmp_path):
    path = tmp_path / "a.webm"
    frames = [*still(30), *still(30, size=(80, 60))]
    write_resized(path, frames)
    with pytest.raises(CaptureError, match=r"160×120 to 80×60 pixels at 1\.00 s; .* --until 1\.00$"):
        list(video_frames(path))
    assert len(list(video_frames(path, stop_s=1.0))) == 30
    assert len(list(video_frames(path, start_s=1.0))) == 30


def test_a_size_that_changes_where_no_time_tells_is_said_with_the_frames_before_it(tmp_path):
    parts = [
        encoded(tmp_path / f"{k}.h264", still(30, size=size), "libx264", b="1000000")
        for k, size in enumerate([(160, 120), (80, 64)])
    ]
    path = tmp_path / "a.h264"
    path.write_bytes(b"".join(part.read_bytes() for part in parts))
    with pytest.raises(
        CaptureError, match=r"160×120 to 80×64 pixels after 30; take these with .* -frames:v 30 PART$"
    ):
        list(grey_frames(path))


@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])
def test_a_stream_that_lacks_a_part_is_damaged_even_where_its_decoder_conceals_it(tmp_path, codec):
    path = encoded(tmp_path / "a.ts", still(60), codec, gop=15, b="1000000")
    data, packet = path.read_bytes(), 188
    middle = len(data) // packet // 2 * packet
    path.write_bytes(data[:middle] + data[middle + 4 * packet :])
    with pytest.raises(CaptureError, match="is damaged or cut off: decoding stops at") as refusal:
        list(grey_frames(path))
    until = float(str(refusal.value).split("--until ")[1].split(",")[0])
    assert 0.5 < until < 1.5
    assert len(list(grey_frames(path, stop_s=until))) == pytest.approx(30 * until, abs=1)


@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])
def test_a_stream_that_was_cut_at_its_start_gives_what_can_be_decoded(tmp_path, codec, caplog):
    whole = encoded(tmp_path / "a.ts", still(60), codec, gop=15, b="1000000")
    data = whole.read_bytes()
    (tmp_path / "b.ts").write_bytes(data[len(data) // 3 :])
    pixels = [frame.pixels for frame in video_frames(whole)]
    with caplog.at_level(logging.WARNING, "tg4mm"):
        frames = list(video_frames(tmp_path / "b.ts"))
    assert "s cannot be decoded, as it was cut there; times are from what can be" in caplog.text
    assert 15 <= len(frames) < 45
    assert len(frames) % 15 == 0
    assert [frame.time for frame in frames] == [Fraction(k, 30) for k in range(len(frames))]
    for k in (0, 7):
        assert np.array_equal(frames[k].pixels, pixels[60 - len(frames) + k])
        assert np.array_equal(frame_picture(Path(f"{tmp_path / 'b.ts'}#{k}"))[..., :3], frames[k].pixels)


@pytest.mark.parametrize(
    ("edits", "frames", "said"),
    [
        ([(0.5, 0.0, 1), (8.0, 0.5, 1 / 8), (1.0, 1.5, 1)], range(60), True),  # slow motion from the middle
        ([(16.0, 0.0, 1 / 8)], range(60), True),
        ([(0.5, 0.0, 1), (0.5, 1.0, 1)], range(60), True),  # a part is cut out
        ([(0.2, -1, 1), (2.0, 0.0, 1)], range(60), False),  # it begins later than its sound
        ([(1.0, 0.5, 1)], range(15, 45), False),  # trimmed
    ],
)
def test_an_edit_list_does_not_change_when_pictures_were_taken(tmp_path, caplog, edits, frames, said):
    path = write_video(tmp_path / "a.mov", still(60), 30, faststart=False, between=0)
    whole = [frame.pixels for frame in video_frames(path)]
    edited(path, edits)
    with caplog.at_level(logging.WARNING, "tg4mm"):
        found = list(video_frames(path))
    assert ("its edit list cuts it, or slows a part down" in caplog.text) == said
    assert [frame.time for frame in found] == [Fraction(k, 30) for k in range(len(frames))]
    assert all(np.array_equal(a.pixels, whole[k]) for a, k in zip(found, frames, strict=True))
    for k in (0, 20):
        assert np.array_equal(frame_picture(Path(f"{path}#{k}"))[..., :3], found[k].pixels)


@pytest.mark.parametrize(
    ("filmed", "stored", "expected", "said"),
    [
        (240, 30, 240, "which is taken; its times, of 30 a second, are those of slow motion"),
        (2, 30, 2, "those of time lapse"),
        (60, 30, None, "which are taken; of slow motion give --fps 60"),  # or a dark scene
        (30.02, 30, None, ""),
        (240, 240, None, ""),
    ],
)
def test_the_rate_that_android_filmed_at_is_taken_and_said(tmp_path, caplog, filmed, stored, expected, said):
    path = tmp_path / "a.mp4"
    about = {"com.android.capture.fps": str(filmed)}
    write_video(path, still(30), stored, about=about)
    with caplog.at_level(logging.WARNING, "tg4mm"):
        assert video_info(path).filmed_at == expected
    assert said in caplog.text
    assert bool(said) == bool(caplog.text)
    assert read_recording(path)[0].times_s[-1] == pytest.approx(29 / (expected or stored))
    fps, times = looked(path).clock()
    assert (fps, times[-1]) == (pytest.approx(expected or stored), pytest.approx(29 / (expected or stored)))
    assert looked(path).clock(stored)[0] == stored


def test_a_window_leaves_out_the_rest_and_keeps_the_times(tmp_path):
    path = write_video(tmp_path / "a.mp4", still(30), 30)
    frames = list(clip_frames(Clip("a", path), TimeWindow(0.5, 0.8)))
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


def _stamps(rate, tick, numbers):
    """Time stamps of frames on a regular clock, rounded to ticks."""
    return [round(Fraction(k) / rate / tick) * tick for k in numbers]


@pytest.mark.parametrize("tick", [Fraction(1, 600), Fraction(1, 1000), Fraction(1, 90000)])
@pytest.mark.parametrize("rate", [*map(Fraction, (25, 30, 60, 120, 240)), NTSC, Fraction(240000, 1001)])
def test_stamps_in_coarse_ticks_are_of_the_clock_that_they_fit(rate, tick):
    """QuickTime's 600 ticks a second make 240 Hz steps of 2 and 3; the container's average is of a length in ticks."""
    stamps = _stamps(rate, tick, range(480))
    average = 480 / (stamps[-1] + math.floor(1 / rate / tick) * tick)
    for rates in ((average, Fraction(600)), ()):
        assert frame_rate(Path("a.mov"), stamps, rates, tick) == rate
        assert regular_times(stamps, rate, tick) == [k / rate for k in range(480)]


@pytest.mark.parametrize("rate", [Fraction("239.97"), Fraction("29.987"), Fraction("119.95")])
def test_a_cameras_own_clock_is_distinguished_from_the_usual_one_by_its_stamps(rate):
    """To a tenth of a tick at the end, though the ticks are coarse and frames are missing."""
    numbers = [k for k in range(6000) if k % 997 != 500]
    stamps, tick = _stamps(rate, Fraction(1, 600), numbers), Fraction(1, 600)
    found = frame_rate(Path("a.mov"), stamps, (), tick)
    assert found == pytest.approx(rate, rel=0.1 * float(tick) * float(rate) / 6000)
    errors = np.array(
        [float(t - k / rate) for t, k in zip(regular_times(stamps, found, tick), numbers, strict=True)]
    )
    assert np.ptp(errors) < 0.1 / 600


def test_milliseconds_stay_what_they_are_in_a_container_of_shorter_ticks():
    stamps = _stamps(NTSC, Fraction(1, 1000), range(300))
    assert frame_rate(Path("a.mp4"), stamps, (), Fraction(1, 16000)) == NTSC
    assert regular_times(stamps, NTSC, Fraction(1, 16000))[299] == 299 / NTSC


def test_a_rate_that_varies_keeps_its_stamps():
    steps = np.random.default_rng(0).integers(3000, 4500, 200)
    stamps, tick = [Fraction(int(t), 90000) for t in np.cumsum(steps)], Fraction(1, 90000)
    assert regular_times(stamps, frame_rate(Path("a.mp4"), stamps, (), tick), tick) == stamps


def test_stamps_that_do_not_rise_are_refused():
    said = r"a: its time stamps do not increase, so the frame rate is unknown"
    with pytest.raises(CaptureError, match=said):
        frame_rate(Path("a"), [Fraction(0)] * 5, ())


class TestDamage:
    def test_one_that_was_cut_off_before_its_index(self, tmp_path):
        """A phone writes the index of its frames when it stops: a copy that breaks off before has none."""
        whole = write_video(tmp_path / "a.mp4", still(20))
        moved = tmp_path / "b.mp4"
        data = whole.read_bytes()
        moved.write_bytes(data[: data.index(b"moov") - 4])
        with pytest.raises(
            CaptureError,
            match=r"its index, at the end of the file, is missing; copy it from the camera again$",
        ):
            video_info(moved)

    def test_sound_alone(self, tmp_path):
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
        said = r"is damaged or cut off: decoding stops at [01]\.\d\d s of 2\.00 s"
        with pytest.raises(CaptureError, match=said):
            list(video_frames(path))

    def test_what_comes_before_can_be_taken_as_it_says(self, tmp_path):
        path = cut_off(write_video(tmp_path / "a.mp4", still(60)), 0.5)
        with pytest.raises(CaptureError) as caught:
            list(video_frames(path))
        until = float(str(caught.value).split("--until ")[1].split(",")[0])
        frames = list(video_frames(path, stop_s=until))
        assert 15 <= len(frames) < 45
