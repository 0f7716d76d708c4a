"""What the commands do with good input: options arrive where they belong, results lie where they should."""

import json
import re

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.cli import main
from tg4mm.core.splatfile import positions_at, read_splat
from tg4mm.run import Run

N_TIMESTEPS, SIZE = 6, 32


def tree(folder, pattern):
    return {str(path.relative_to(folder)) for path in folder.rglob(pattern)}


def recorded(folder):
    return json.loads((folder / "render.json").read_text())


def test_export_of_a_sequence_takes_alpha_and_band(run_path, tmp_path):
    main(["export", str(run_path), "--out", str(tmp_path / "a.ply")])
    splat = read_splat(tmp_path / "a.ply")
    for name, band in (("inside", (4.0, 6.0)), ("outside", (1.0, 2.0))):
        common = ["--format", "ply-sequence", "--alpha", "10", "--allow-empty-band"]
        options = [*common, "--band", *map(str, band)]
        assert main(["export", str(run_path), "--out", str(tmp_path / name), *options]) == 0
        frame = read_splat(tmp_path / name / "frame_0002.ply")
        np.testing.assert_allclose(frame.means, positions_at(splat, 2, 10.0, band), atol=1e-5)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("x.spz", "expected a name that ends in .ply, such as {}/x.ply"),
        ("x", "such as {}/x.ply, or {}/x/splat.ply"),
        ("x/", "such as {}/x.ply, or {}/x/splat.ply"),
    ],
)
def test_a_splat_file_is_named_as_one(run_path, tmp_path, capsys, name, said):
    assert main(["export", str(run_path), "--out", f"{tmp_path}/{name}"]) == 2
    assert said.replace("{}", str(tmp_path)) in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main(["export", str(run_path), "--out", f"{tmp_path}/x.PLY"]) == 0


def test_render_takes_split_band_and_no_video(run_path, tmp_path):
    out = tmp_path / "train"
    options = ["--split", "train", "--band", "4", "6", "--no-video", "--alpha", "-1"]
    assert main(["render", str(run_path), "--out", str(out), *options]) == 0
    assert len(tree(out, "*.png")) == 3 * N_TIMESTEPS
    assert tree(out, "*.mp4") == set()
    assert (recorded(out)["alpha"], recorded(out)["band_hz"]) == (-1.0, [4.0, 6.0])


def test_render_takes_an_orbit_in_slow_motion(run_path, tmp_path):
    out = tmp_path / "orbit"
    options = ["--alpha", "3", "--orbit", "4", "--slow", "2"]
    assert main(["render", str(run_path), "--out", str(out), *options]) == 0
    assert tree(out, "*.png") == {f"r_{i:03d}.png" for i in range(4)}
    assert tree(out, "*.mp4") == {"orbit.mp4"}
    assert recorded(out)["slow"] == 2.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--alpha", "inf"], "--alpha inf"),
        (
            ["--alpha", "1", "--alpha", "2"],
            "--alpha is given 2 times, --band 0 times: without --band there is one",
        ),
        (["--alpha", "1", "--band", "1", "2", "--band", "3", "4"], "each band needs its own"),
        (["--alpha", "1", "--band", "4"], "--band '4' is neither two frequencies in Hz"),
        (
            ["--alpha", "1", "--band", "4", "--no-video"],
            "--band '4' is neither two frequencies in Hz, LO HI, nor auto",
        ),
        (["--alpha", "1", "--band", "--no-video"], "--band '' is neither two frequencies in Hz"),
        (["--alpha", "1", "--band=4", "--no-video"], "--band '4' is neither two frequencies in Hz"),
        (["--alpha", "1", "--band", "-4", "6"], "band (-4, 6) Hz starts below 0 Hz"),
        (
            ["--alpha", "1", "--band", "7.2", "7.4"],
            "--band 7.2 7.4: no motion was found there; no vibration stands out, and the modes lie at 5 Hz; --allow",
        ),
        (
            ["--alpha", "1", "--alpha", "2", "--band", "1", "4", "--band", "3", "5"],
            "overlap: 3 Hz lies in both",
        ),
        (["--alpha", "1", "--method", "phase"], "--method phase"),
        (["--alpha", "1", "--filter", "ideal"], "--filter ideal goes with --band: without one nothing is"),
        (
            ["--alpha", "1", "--band", "4", "6", "--filter", "ideal"],
            "--filter ideal: the method modal picks modes",
        ),
        (["--alpha", "1", "--amplitude-percentile", "50"], "--amplitude-percentile is of the method phase"),
        (["--alpha", "1", "--slow", "2", "--no-video"], "--slow 2 and --no-video exclude each other"),
        (["--alpha", "1", "--band", "4", "40"], "(4, 40) Hz reaches past half the frame rate"),
        (["--alpha", "1", "--slow", "0"], "--slow 0"),
        (["--alpha", "1", "--slow", "1e9"], "pictures a second: expected 0.01 … 10000; see --slow"),
        (["--alpha", "nan"], "--alpha nan"),
        (["--alpha", "1e308"], "must be within ±1e+06"),
        (["--alpha", "1", "--cameras", "nowhere.json"], "nowhere.json: cannot be read"),
    ],
)
def test_render_refuses_bad_values(run_path, tmp_path, capsys, options, message):
    assert main(["render", str(run_path), "--out", str(tmp_path / "o"), *options]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["train", "DATA", "--out", "FILE/x"],
        ["render", "RUN", "--alpha", "1", "--out", "FILE/x"],
        ["render", "RUN", "--alpha", "1", "--out", "FILE"],
        ["evaluate", "RUN", "--out", "FILE/x/m.json"],
        ["export", "RUN", "--out", "FILE/x/a.ply"],
        ["export", "RUN", "--out", "FILE/x", "--format", "ply-sequence"],
    ],
)
def test_out_that_cannot_be_made_is_one_line(run_path, tmp_path, capsys, arguments):
    (tmp_path / "file").write_text("mine")
    places = {"RUN": str(run_path), "DATA": str(run_path.parent / "data"), "FILE": str(tmp_path / "file")}
    for name, path in places.items():
        arguments = [a.replace(name, path, 1) if a.startswith(name) else a for a in arguments]
    assert main(arguments) == 2
    line = capsys.readouterr().err
    file = re.escape(places["FILE"])
    reasons = rf"{file}[/x]*(: | cannot be written: )(Not a directory|File exists)|{file} is a file, expected a folder"
    assert re.fullmatch(rf"tg4mm: ({reasons})\n", line), line
    assert (tmp_path / "file").read_text() == "mine"


def test_without_test_cameras_render_names_the_others(tmp_path, capsys):
    gaussians, _ = make_synthetic_dataset(tmp_path / "data", n_views=2, n_timesteps=1, size=SIZE, n_test=0)
    run = Run.create(tmp_path / "run", tmp_path / "data", "modal", {})
    run.save_space(gaussians, {})
    command = ["render", str(run.path), "--alpha", "0", "--out", str(tmp_path / "o")]
    assert main(command) == 2
    assert "no 'test' split; choose --split train, --orbit N or --cameras FILE" in capsys.readouterr().err
    assert main([*command, "--split", "test"]) == 2
    assert "choose" not in capsys.readouterr().err
    assert main([*command, "--split", "train"]) == 0
    (tmp_path / "data").rename(tmp_path / "gone")
    assert main(command) == 2
    assert "choose" not in capsys.readouterr().err


def test_evaluate_prints_a_table_and_writes_the_figures(run_path, tmp_path, capsys):
    out = tmp_path / "metrics.json"
    assert main(["evaluate", str(run_path), "--alphas", "5", "--out", str(out)]) == 0
    metrics = json.loads(out.read_text())
    assert [entry["alpha"] for entry in metrics["alphas"]] == [0, 5]
    printed = capsys.readouterr().out
    assert "| 5 |" in " ".join(printed.split())
    assert "nothing moves" in printed


def test_evaluate_refuses_an_alpha_without_ground_truth(run_path, tmp_path, capsys):
    out = tmp_path / "metrics.json"
    assert main(["evaluate", str(run_path), "--alphas", "5,3", "--out", str(out)]) == 2
    assert "--alphas holds α = 3: no such ground truth under" in capsys.readouterr().err
    assert not out.exists()


def test_evaluate_refuses_a_band_without_motion(run_path, tmp_path, capsys):
    out = tmp_path / "metrics.json"
    command = ["evaluate", str(run_path), "--alphas", "5", "--band", "6.4", "7", "--out", str(out)]
    assert main(command) == 2
    assert "--band 6.4 7: no motion was found there" in capsys.readouterr().err
    assert not out.exists()
    assert main([*command, "--allow-empty-band"]) == 0


def test_a_killed_generator_is_said_and_leaves_with_1(monkeypatch, capsys):
    class Killed:
        def __init__(self, command, **options): ...
        def __enter__(self):
            return self

        def __exit__(self, *_): ...
        def wait(self):
            return -9

    monkeypatch.setattr("tg4mm.research.generator.subprocess.Popen", Killed)
    assert main(["generate", "mic", "--out", "x"]) == 1
    assert "ended by signal 9; run the same command again" in capsys.readouterr().err
