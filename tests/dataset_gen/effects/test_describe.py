"""Effects as options: what is off, what cannot be, what goes with what."""

import re

import pytest

from dataset_gen.__main__ import main
from dataset_gen.options import parser, request_from


def settings(*options):
    return request_from(parser().parse_args(["mic", "--out", "x", *options])).sets[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--shake -1", r"--shake -1.0 is not in 0 … 20 pixels"),
        ("--shake nan", r"--shake nan"),
        ("--shake 50", r"--shake 50.0 is not in"),
        ("--exposure-drift 100", r"--exposure-drift 100.0 is not in 0 … 90 percent"),
        ("--exposure-drift 5", r"--exposure-drift acts on the whole picture: use --background white"),
        ("--flicker 2", r"--flicker acts on the whole picture: use --background white"),
        ("--flicker 99", r"--flicker 99.0 is not in"),
        ("--flicker 2 --flicker-hz 0", r"--flicker-hz 0.0 is not in"),
        ("--flicker-hz 120", r"--flicker-hz 120 goes with --flicker"),
        ("--codec h264", r"--codec h264 needs --background white and --images png8"),
        ("--codec h264 --background white --images png16", r"--codec h264 needs"),
        (
            "--codec h264 --background white --size 97",
            r"--size 97: --codec h264 at 4:2:0 needs an even number",
        ),
        ("--codec h264 --background white --crf 52", r"--crf 52 is not a whole number in 0 … 51"),
        ("--codec vp9", r"argument --codec: invalid choice: 'vp9'"),
        ("--crf 20", r"--crf 20 goes with --codec"),
        ("--keep-video", r"--keep-video goes with --codec"),
        (
            "--shake 1 --timesteps 1",
            r"--timesteps 1: shake, drift, flicker, readout and a codec need at least 2 timesteps",
        ),
        ("--readout 40", r"--readout 40 is more than the 33.33 ms of a frame at --fps 30"),
        ("--readout -1", r"--readout -1.0 is not in 0 … 1000 milliseconds"),
        ("--readout nan", r"--readout nan is not in"),
        ("--readout 12 --shake 1", r"--readout 12 is for cameras that stand still, not with --shake 1"),
        (
            "--readout 12 --cameras handheld",
            r"--readout 12 is for cameras that stand still, not with --cameras handheld",
        ),
        ("--cameras flat --views 3", r"--views 3: with --cameras flat there is one camera"),
        ("--cameras flat --test-views 2", r"--test-views 2: --cameras flat has one at most"),
        ("--cameras clips --clock-offsets 1", r"--clock-offsets 1: with --cameras clips no two cameras"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(arguments, message, tmp_path, capsys):
    assert main(["mic", *arguments.split(), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert re.search(message, err), err
    assert not (tmp_path / "out").exists()


def test_clips_are_seven_unless_said_otherwise():
    assert settings("--cameras", "clips").cameras.views == 7
    assert settings("--cameras", "clips", "--views", "12").cameras.views == 12
    assert settings("--cameras", "clips", "--preset", "smoke").cameras.views == 4


def test_a_motion_that_is_not_steady_is_refused_for_clips(tmp_path, capsys):
    file = tmp_path / "m.yaml"
    for more in ("decay: 1.0", "name: b, kind: drift, rate: 0.01, direction: [1, 0, 0]"):
        first = "name: a, kind: translate, frequency: 3, amplitude: 0.01, direction: [1, 0, 0]"
        modes = f"  - {{{first}, {more}}}\n" if "decay" in more else f"  - {{{first}}}\n  - {{{more}}}\n"
        file.write_text(f"modes:\n{modes}")
        options = ["mic", "--motion", str(file), "--cameras", "clips", "--out", str(tmp_path / "out")]
        assert main(options) == 2
        assert re.search("--cameras clips needs a steady vibration; mode '[ab]' ", capsys.readouterr().err)
