"""Bad input is refused with one line that names the option and the value."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from dataset_gen.__main__ import main
from dataset_gen.options import parser, request_from

ROOT = Path(__file__).resolve().parents[2]
REFUSED = {
    "violin": r"scene 'violin' is not one of chair, .*, ship, all",
    "": r"give either SCENE, --blend or --mesh; none of them given",
    "mic --blend a.blend": r"scene and blend given",
    "--blend absent.blend": r"--blend absent.blend: there is no such file",
    "mic --amplitude 1 --amplitude-px 1": r"--amplitude-px: not allowed with .* --amplitude",
    "mic --motion absent.yaml": r"absent.yaml",
    "mic --jpeg 50": r"--jpeg 50 needs --sensor",
    "mic --sensor phone --images exr": r"--images exr cannot be combined",
    "mic --sensor phone": r"JPEG, which needs --images png8 and --background white",
    "mic --part 3": r"'3' is not a part such as 3/10",
    "mic --cameras handheld --views 9": r"--views 9: with --cameras handheld there is one",
    "mic --cameras given": r"--cameras given needs a scene of your own",
    "mic --test-views 0 --alphas 5,10": r"--alphas 5,10: .* --test-views 0 leaves none",
    "mic --test-views 0 --truth test": r"--truth test: --test-views 0 leaves none",
    "mic --engine eevee --device gpu": r"--device gpu is where Cycles runs; --engine eevee",
    "mic --frame 3": r"--frame 3 needs --blend",
    "mic --scene Scene": r"--scene Scene needs --blend",
    "mic --prepare --parts 0": r"--parts 0 needs --prepare and is at least 1",
    "mic --prepare --processes 2": r"--processes 2: --prepare renders nothing",
    "mic --save-blend a.blend": r"--out .*out: --save-blend only saves the animation",
    "mic --views 2": r"--views 2: on the orbit both would stand",
    "mic --name me": r"--name me needs --blend or --mesh",
    "mic --prepare --finish": r"--finish: not allowed with .* --prepare",
    "all --save-blend a.blend": r"--save-blend a.blend takes one scene",
    "mic --amplitude 0": r"--amplitude 0.0 is not a positive number",
    "mic --amplitude nan": r"--amplitude nan is not a finite number",
    "mic --frequency 15":
        r"mic.yaml: mode 'bending': frequency 15 Hz is not below half the frame rate, 15 Hz \(fps 30\)",
    "mic --fps 1e300": r"--fps 1e\+300 is not in 0.001 … 1e\+06 Hz",
    "mic --size 0": r"--size 0 is not a whole number in 8",
    "mic --seed -1": r"--seed -1",
    "mic --alphas 5,x": r"'5,x' is not a list of numbers",
    "mic --alphas 5,5": r"--alphas 5,5 names a factor twice",
    "mic --alphas 2.5": r"--alphas 2.5: .* whole number",
    "mic --processes -2": r"--processes -2 is negative",
    "mic --shake -1": r"--shake -1.0 is not in 0 … 20 pixels",
    "mic --exposure-drift 100": r"--exposure-drift 100.0 is not in 0 … 90 percent",
    "mic --exposure-drift 5": r"--exposure-drift acts on the whole picture: use --background white",
    "mic --flicker 2": r"--flicker acts on the whole picture: use --background white",
    "mic --flicker 2 --flicker-hz 0": r"--flicker-hz 0.0 is not in",
    "mic --flicker-hz 120": r"--flicker-hz 120 needs --flicker",
    "mic --codec h264": r"--codec h264 needs --background white and --images png8",
    "mic --codec h264 --background white --images png16": r"--codec h264 needs",
    "mic --codec h264 --background white --size 97": r"--size 97: --codec h264 at 4:2:0 needs an even number",
    "mic --codec h264 --background white --crf 52": r"--crf 52 is not a whole number in 0 … 51",
    "mic --crf 20": r"--crf 20 needs --codec",
    "mic --keep-video": r"--keep-video needs --codec",
    "mic --shake 1 --timesteps 1":
        r"--timesteps 1: shake, drift, flicker, readout, shutter and a codec need at least 2 timesteps",
    "mic --readout 40": r"--readout 40 is more than the 33.33 ms of a frame at --fps 30",
    "mic --shutter 40": r"--shutter 40 is more than the 33.33 ms of a frame at --fps 30",
    "mic --shutter 9 --readout 12": r"--shutter 9 blurs whole pictures, so it excludes --readout 12",
    "mic --noise picture --engine eevee": r"--noise picture needs --engine cycles: eevee has no seed",
    "mic --readout -1": r"--readout -1.0 is not in 0 … 1000 milliseconds",
    "mic --readout 12 --shake 1": r"--readout 12 is for cameras that stand still, not with --shake 1",
    "mic --readout 12 --cameras handheld":
        r"--readout 12 is for cameras that stand still, not with --cameras handheld",
    "mic --cameras flat --views 3": r"--views 3: with --cameras flat there is one camera",
    "mic --cameras flat --test-views 2": r"--test-views 2: --cameras flat has one at most",
    "mic --cameras clips --clock-offsets 1": r"--clock-offsets 1: with --cameras clips no two cameras",
}  # fmt: skip

FOLDERS = {
    "mic": "mic_5Hz_0_005", "mic --frequency 2.5 --amplitude 0.01": "mic_2_5Hz_0_01",
    "mic --amplitude 0.00002": "mic_5Hz_0_00002", "mic --amplitude 2 --fps 240 --frequency 100": "mic_100Hz_2",
    "mic --amplitude-px 0.2": "mic_5Hz_0_2px",
}  # fmt: skip

TIMESTEPS = {
    "ficus --preset smoke": 10,  # 3 Hz: six timesteps are six tenths of a period
    "mic --preset smoke": 6,  # 5 Hz
    "mic --preset smoke --frequency 4": 8,  # 15 hold whole periods, 7.5 one
    "mic --preset smoke --frequency 0.7": 43,  # a period at any rate
    "ficus": 30, "mic --frequency 4": 30, "ficus --fps 24": 32,
    "ficus --preset smoke --timesteps 6": 6,  # as requested
}  # fmt: skip


def request(*arguments):
    return request_from(parser().parse_args([*arguments, "--out", "x"]))


def settings(*arguments):
    return request(*arguments).sets[0]


@pytest.mark.parametrize("arguments", REFUSED)
def test_bad_input_is_one_line_and_exit_2(arguments, tmp_path, capsys):
    assert main([*arguments.split(), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert re.search(REFUSED[arguments], err), err
    assert not (tmp_path / "out").exists()


def test_a_motion_that_is_not_steady_is_refused_for_clips(tmp_path, capsys):
    file = tmp_path / "m.yaml"
    for more in ("decay: 1.0", "name: b, kind: drift, rate: 0.01, direction: [1, 0, 0]"):
        first = "name: a, kind: translate, frequency: 3, amplitude: 0.01, direction: [1, 0, 0]"
        modes = f"  - {{{first}, {more}}}\n" if "decay" in more else f"  - {{{first}}}\n  - {{{more}}}\n"
        file.write_text(f"modes:\n{modes}")
        options = ["mic", "--motion", str(file), "--cameras", "clips", "--out", str(tmp_path / "out")]
        assert main(options) == 2
        assert re.search("--cameras clips needs a steady vibration; mode '[ab]' ", capsys.readouterr().err)


@pytest.mark.parametrize(
    "named", ["--prepare", "--part 1/2", "--samples 4", "--alphas 5,10", "--sensor phone"]
)
def test_what_an_animation_has_no_use_for_is_refused(named, tmp_path, capsys):
    assert main(["mic", "--save-blend", str(tmp_path / "a.blend"), *named.split()]) == 2
    err = capsys.readouterr().err
    assert err == f"error: {named}: --save-blend only saves the animation, it renders nothing\n"


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("mic_5Hz_0_005/thesis.tex", "mine", "is not empty and holds no scene.json"),
        ("mic_5Hz_0_005/scene.json", "{", "scene.json is not readable JSON"),
        ("mic_5Hz_0_005", "", "is a file, expected a folder"),
    ],
)
def test_a_foreign_folder_is_refused_and_stays(tmp_path, capsys, file, content, message):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(content)
    before = sorted(tmp_path.rglob("*"))
    assert main(["mic", "--out", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / file).read_text() == content


@pytest.mark.parametrize("arguments", FOLDERS)
def test_folder_name(arguments):
    assert settings(*arguments.split()).folder == FOLDERS[arguments]


def test_describing_scenes_needs_neither_bpy_nor_torch():
    code = (
        "import sys; sys.modules['bpy'] = sys.modules['torch'] = sys.modules['PIL'] = None\n"
        "import dataset_gen.__main__, dataset_gen.points, dataset_gen.truth, dataset_gen.tree\n"
        "from dataset_gen.prepare import builtin_bodies\n"
        "print(len(builtin_bodies('mic')))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(done.stdout) > 5


def test_a_signal_handler_that_the_host_set_does_not_end_it(monkeypatch, capsys):
    """Blender sets handlers in C, which Python reads as None and cannot set again."""

    def set_handler(number, handler):
        assert handler is not None

    monkeypatch.setattr("dataset_gen.__main__.signal.signal", set_handler)
    assert main(["violin", "--out", "x"]) == 2
    assert "scene 'violin'" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", TIMESTEPS)
def test_records_hold_whole_periods_unless_the_number_is_given(arguments):
    assert settings(*arguments.split()).timesteps == TIMESTEPS[arguments]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("mic --frequency 3 --timesteps 6", "6 timesteps hold 0.6 periods of 3 Hz"),
        ("mic --frequency 5 --timesteps 6", ""),
        ("mic --frequency 5 --timesteps 1", ""),
        ("mic --frequency 3", ""),
    ],
)
def test_a_record_of_less_than_a_period_has_a_line(arguments, said, capsys):
    settings(*arguments.split())
    error = capsys.readouterr().err
    assert said in error
    assert bool(error) == bool(said)
    if said:
        assert "--timesteps 10 hold one" in error
