"""Bad input is refused with one line that names the option and the value."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from dataset_gen.__main__ import PRESETS, main, parser, settings_from
from dataset_gen.settings import Settings

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["violin"], r"scene 'violin' is none of mic"),
        (["mic", "--amplitude", "0"], r"--amplitude 0.0 is not a positive number"),
        (["mic", "--amplitude", "-1"], r"--amplitude -1.0 is not a positive number"),
        (["mic", "--amplitude", "nan"], r"--amplitude nan is not a positive number"),
        (["mic", "--amplitude", "inf"], r"--amplitude inf"),
        (["mic", "--amplitude", "1e-20"], r"1e-20 is too small"),
        (
            ["mic", "--frequency", "15"],
            r"--frequency 15 Hz is not below half the frame rate, 15 Hz \(--fps 30\)",
        ),
        (["mic", "--frequency", "0"], r"--frequency 0.0 is not a positive number"),
        (["mic", "--fps", "nan"], r"--fps nan"),
        (["mic", "--size", "0"], r"--size 0 is not a whole number in 8"),
        (["mic", "--size", "99999"], r"--size 99999"),
        (["mic", "--size", "big"], r"argument --size: invalid int value: 'big'"),
        (["mic", "--timesteps", "1001"], r"--timesteps 1001"),
        (["mic", "--views", "0"], r"--views 0"),
        (["mic", "--samples", "0"], r"--samples 0"),
        (["mic", "--seed", "-1"], r"--seed -1"),
        (["mic", "--alphas", "5,x"], r"'5,x' is not a list of numbers"),
        (["mic", "--alphas", "5,5"], r"--alphas 5,5 names a factor twice"),
        (["mic", "--alphas", "2.5"], r"--alphas 2.5: .* whole number"),
        (["mic", "--alphas", "inf"], r"'inf' is not a list of numbers"),
        (["mic", "--truth", "some"], r"argument --truth: invalid choice: 'some'"),
        (["mic", "--processes", "-2"], r"--processes -2 is negative"),
        (["mic", "--sise", "3"], r"unrecognized arguments: --sise 3"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(arguments, message, tmp_path, capsys):
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert re.search(message, err), err
    assert not (tmp_path / "out").exists()


def test_a_foreign_folder_is_refused(tmp_path, capsys):
    folder = tmp_path / "mic_5Hz_0_005"
    folder.mkdir()
    (folder / "thesis.tex").write_text("mine")
    assert main(["mic", "--out", str(tmp_path)]) == 2
    assert "is not empty and holds no scene.json" in capsys.readouterr().err
    assert [path.name for path in folder.iterdir()] == ["thesis.tex"]


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path, capsys):
    (tmp_path / "mic_5Hz_0_005").write_text("")
    assert main(["mic", "--out", str(tmp_path)]) == 2
    assert "is a file, not a folder" in capsys.readouterr().err


def test_a_broken_description_is_refused(tmp_path, capsys):
    (tmp_path / "mic_5Hz_0_005").mkdir()
    (tmp_path / "mic_5Hz_0_005/scene.json").write_text("{")
    assert main(["mic", "--out", str(tmp_path)]) == 2
    assert "scene.json cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({}, "mic_5Hz_0_005"),
        ({"frequency": 2.5, "amplitude": 0.01}, "mic_2_5Hz_0_01"),
        ({"amplitude": 0.00002}, "mic_5Hz_0_00002"),
        ({"amplitude": 2.0, "fps": 240.0, "frequency": 100.0}, "mic_100Hz_2"),
    ],
)
def test_folder_name(changes, name):
    assert Settings(**changes).folder == name


def test_options_go_before_the_preset_and_the_preset_before_the_defaults():
    chosen = settings_from(parser().parse_args(["mic", "--out", "x", "--preset", "smoke", "--views", "9"]))
    assert (chosen.views, chosen.size, chosen.fps) == (9, PRESETS["smoke"]["size"], Settings().fps)


def test_settings_survive_json():
    settings = Settings(alphas=(5, 100), frequency=3.7)
    assert Settings.from_json(settings.to_json()) == settings


def test_help_shows_units_and_defaults(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    for words in (
        "largest displacement, scene units (default: 0.005)",
        "Hz; below half of --fps (default: 5)",
        "pixels (default: 128)",
        "(default: 5,10,20,50)",
    ):
        assert words in text


def test_describing_scenes_needs_neither_bpy_nor_torch():
    code = (
        "import sys; sys.modules['bpy'] = sys.modules['torch'] = sys.modules['PIL'] = None\n"
        "import dataset_gen.__main__, dataset_gen.points, dataset_gen.truth, dataset_gen.tree\n"
        "from dataset_gen.scenes import SCENES\n"
        "print(len(SCENES['mic'](5.0, 0.005).shapes()))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(done.stdout) > 5
