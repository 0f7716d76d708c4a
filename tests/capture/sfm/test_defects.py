"""Recordings that hardly change, or of which only a part can be used: said, and what to use instead."""

import warnings

import av
import numpy as np
import pytest

from tests.capture.sfm.videos import SIZE, cut_off, encoded, looked, spoil, still, texture, write_video
from tg4mm.capture.sfm.defects import check_usable, is_fixed, warn_bumps, warn_clocks, warn_light
from tg4mm.capture.sfm.steadiness import find_bumps
from tg4mm.cli import main

ENCODERS = {
    "crf 18": ("libx264", {"gop": 12, "crf": "18"}),
    "crf 26": ("libx264", {"gop": 12, "crf": "26"}),
    "one key frame": ("libx264", {"gop": 250, "crf": "30"}),
    "constant rate": ("libx264", dict.fromkeys(("b", "maxrate", "minrate", "bufsize"), "1000000")),
    "all intra": ("libx264", {"gop": 1, "crf": "23"}),
    "MPEG-4": ("mpeg4", {"gop": 12, "b": "1000000"}),
    "VP9": ("libvpx-vp9", {"crf": "31", "cpu_used": "5"}),
    "average rate": ("libx264", {"b": "300000"}),
    "VP8": ("libvpx", {"b": "500000"}),
    "VP8, live": ("libvpx", {"b": "500000", "deadline": "realtime", "lag_in_frames": "0"}),
}
BLACK = np.full((SIZE[1], SIZE[0], 3), 2, np.uint8)
ELSEWHERE = [np.roll(frame[:, ::-1], 40, axis=0) for frame in still(40)]


def times(frames, start, stop):
    return [*frames[:start], *[frames[start - 1]] * (stop - start), *frames[stop:]]


class TestFrozen:
    @pytest.mark.parametrize("name", ENCODERS)
    def test_one_picture_is_said_whatever_the_codec_makes_of_it(self, tmp_path, name):
        codec, options = ENCODERS[name]
        if codec not in av.codecs_available:
            pytest.skip(f"no {codec}")
        path = encoded(tmp_path / "a.mkv", [texture().astype(np.uint8)] * 60, codec, **options)
        said = r"a\.mkv: hardly anything changes .*: the recording is a single picture, or"
        with pytest.warns(UserWarning, match=said):
            assert looked(path).repeats == ()

    @pytest.mark.parametrize("crf", [18, 23])
    @pytest.mark.parametrize("noise", [1, 2])
    def test_a_still_scene_with_a_sensors_noise_is_not_frozen(self, tmp_path, noise, crf):
        assert is_fixed(looked(write_video(tmp_path / "a.mp4", still(60, noise=noise), crf=crf)))

    def test_a_small_thing_that_moves_without_noise_is_not_frozen(self, tmp_path):
        from scipy.ndimage import shift

        frames, thing = [], texture((40, 40), seed=9)
        for t in range(60):
            moved = shift(thing, (np.sin(2 * np.pi * 3.4 * t / 30), 0, 0), order=3, mode="nearest")
            frames.append(texture().astype(np.uint8))
            frames[-1][40:72, 60:92] = np.clip(moved[4:-4, 4:-4], 0, 255)
        looked(write_video(tmp_path / "a.mp4", frames, crf=18))


SPOILT = {
    "the end is black": (
        [*still(60), *[BLACK] * 20],
        "is black from 2.000 s to 2.633 s; take --until 2.000",
    ),
    "half is black": ([*[BLACK] * 40, *still(40)], "is black from 0.000 s to 1.300 s; take --from 1.333"),
    "a cut": ([*still(40), *ELSEWHERE], "shows another picture from 1.333 s to 2.633 s; take --until 1.333"),
    "something before the lens": (
        [*still(30), *ELSEWHERE[:8], *still(42)],
        "shows another picture from 1.000 s to 1.233 s; take --until 1.000 or --from 1.266",
    ),
    "two knocks": (
        still(80, shifts=[0] * 25 + [5] * 25 + [-6] * 30),
        "the camera was knocked at 0.833 s: the whole picture moves by 5.0 pixels; the camera was knocked at 1.666 s: "
        "the whole picture moves by 11.0 pixels; take --until 0.833 or --from 0.833 --until 1.666 or --from 1.666",
    ),
    "the end is frozen": (
        times(still(90), 60, 90),
        "shows one frozen picture from 2.033 s to 2.966 s; take --until 2.033",
    ),
    "most is frozen": (
        times(still(80), 20, 80),
        "shows one frozen picture from 0.700 s to 2.633 s; take --until 0.700",
    ),
    "a few are left": ([*still(5), *[BLACK] * 20], "no part of it is long enough; record it again"),
}  # fmt: skip


class TestPartly:
    @pytest.mark.parametrize("name", SPOILT)
    def test_the_part_to_use_is_named(self, tmp_path, capsys, name):
        frames, expected = SPOILT[name]
        path = write_video(tmp_path / "a.mp4", frames)
        options = ["--kind", "flat"] if "knock" in name else []
        assert main(["sfm", str(path), "--out", str(tmp_path / "out"), *options]) == 2
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith(f"tg4mm: {path}: ")
        assert expected in last
        advice = last.rpartition("take ")[2].split(" or ")[-1].split()
        if "--" in last:
            assert main(["sfm", str(path), "--out", str(tmp_path / "out2"), *options, *advice]) == 0

    def test_a_bump_is_said_with_its_time(self, tmp_path):
        shifts = [0] * 30 + [6] * 3 + [0] * 27
        survey = looked(write_video(tmp_path / "a.mp4", still(60, shifts=shifts)))
        check_usable([survey], True)
        said = r"a\.mp4: the camera was bumped .* at 1\.000 s \(by 6\.\d pixels\)"
        with pytest.warns(UserWarning, match=said):
            warn_bumps([survey])

    def test_trembling_vibration_knocks_and_drift_are_no_bumps(self):
        at = np.arange(120) / 30
        rng = np.random.default_rng(0)
        for shifts in (rng.normal(0, 0.5, 120), 4 * np.sin(2 * np.pi * 3.4 * at), 5.0 * (at > 2), 3 * at):
            assert find_bumps(np.stack([shifts, 0 * at], axis=1), at) == []

    def test_steps_of_exposure_and_white_balance_are_said_with_their_times(self, tmp_path):
        frames = np.stack(still(60)).astype(float)
        frames[40:] *= 0.8
        frames[20:, ..., 0] *= 1.08
        path = write_video(tmp_path / "a.mp4", list(np.clip(frames, 0, 255).astype(np.uint8)))
        said = r"a\.mp4: exposure changes by 2\d.* %.* at 1\.[345] s and white balance .* [78].* %.* at 0\.[67] s"
        with pytest.warns(UserWarning, match=said):
            warn_light([looked(path)])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warn_light([looked(write_video(tmp_path / "b.mp4", still(60)))])

    def test_another_rate_than_the_files_is_said(self, tmp_path):
        survey = looked(write_video(tmp_path / "a.mp4", still(12), 30))
        said = r"a\.mp4: the file says 30 frames per second, --fps 300: .* divided by 10"
        with pytest.warns(UserWarning, match=said):
            warn_clocks([survey], 300.0)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warn_clocks([survey], 30.0)


def _bad(name, path):
    """A bad recording and what is said of it."""
    if name == "no video":
        path.write_bytes(b"nothing of a video" * 50)
        return path, "is not a video that can be decoded"
    if name == "cut off":
        return cut_off(write_video(path, still(60)), 0.5), "is damaged or cut off: decoding stops at"
    if name == "spoilt":
        return spoil(write_video(path, still(60)), 0.5), "is damaged or cut off: decoding stops at"
    if name == "no overlap":
        rng = np.random.default_rng(0)
        frames = [rng.integers(0, 255, (120, 160, 3), np.uint8).astype(np.uint8) for _ in range(12)]
        return write_video(path, frames), "taken for a moving camera as"
    frames, said = {
        "black": ([BLACK] * 20, "is black: its brightest"),
        "knocked": (still(60, shifts=[0] * 30 + [5] * 30), "knocked at 1.000 s"),
        "five frames": (still(5), "holds 5 frames, too few to show motion; at least 6"),
        "one frame": (still(1), "holds 1 frames, at least 2"),
    }[name]
    return write_video(path, frames), said


@pytest.mark.parametrize(
    "name", ["no video", "cut off", "spoilt", "black", "knocked", "five frames", "one frame", "no overlap"]
)
def test_a_bad_recording_is_one_line_and_nothing_else(tmp_path, capsys, name):
    path, said = _bad(name, tmp_path / "a.mp4")
    assert main(["sfm", str(path), "--out", str(tmp_path / "out")]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("tg4mm: ")]
    assert len(errors) == 1
    assert said in errors[0]
    assert not (tmp_path / "out" / "scene.json").exists()
