"""What a measurement leaves behind: JSON, CSV, UFF that another program reads, plots, and what is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.show.measure.filmed import BALL, BALL_SPHERE, PARTS, modes, of_parts, run_of, sine
from tg4mm.cli.program import main

AMPLITUDE = np.array([0.008, 0.0, 0.006])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory):
    """A ball at 5 Hz, with its modes."""
    phasors = np.zeros((sum(PARTS), 3), complex)
    phasors[BALL] = AMPLITUDE
    root = tmp_path_factory.mktemp("run")
    return run_of(
        root, of_parts(ball=sine(5.0, AMPLITUDE)), modes({5.0: phasors}, 24), n_timesteps=24, noise=0.004
    )


@pytest.fixture(scope="module")
def out(run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the command wrote."""
    folder = tmp_path_factory.mktemp("out") / "measured"
    words = ["measure", str(run.path), "--out", str(folder), "--sensor", BALL_SPHERE, "--sensor", "all"]
    assert main(words) == 0
    return folder


def test_json_and_tidy_csv_say_the_same_in_their_units(out: Path) -> None:
    found = json.loads((out / "measure.json").read_text())
    ball = found["sensors"][0]
    assert ball["peaks"][0]["frequency_hz"] == pytest.approx(5.0, abs=0.03)
    rows = list(csv.DictReader((out / "series.csv").open()))
    assert len(rows) == 2 * 24 * 3
    own = [r for r in rows if r["sensor"] == "ball" and r["axis"] == "x"]
    millimetres = [float(r["displacement_mm"]) for r in own]
    assert millimetres == pytest.approx(
        [100 * d[0] for d in ball["series"][0]["displacement"]], rel=1e-4, abs=1e-4
    )
    peaks = list(csv.DictReader((out / "peaks.csv").open()))
    assert float(peaks[0]["amplitude_mm"]) == pytest.approx(0.8, rel=0.1)


def test_another_program_reads_geometry_shapes_and_waveforms(out: Path) -> None:
    import pyuff

    file = pyuff.UFF(str(out / "measure.uff"))
    kinds = file.get_set_types().tolist()
    assert set(kinds) == {15, 55, 58, 82, 164}
    nodes = file.read_sets(kinds.index(15))
    at = dict(
        zip(
            np.asarray(nodes["node_nums"], int),
            zip(nodes["x"], nodes["y"], nodes["z"], strict=True),
            strict=True,
        )
    )
    assert at[1] == pytest.approx(
        [0.05, 0.01, 0.037], abs=0.012
    )  # metres: 0.1 a unit; the upper side is seen more
    assert len(at) > 100
    lines = file.read_sets(kinds.index(82))
    assert {int(n) for n in lines["nodes"]} - {0} <= set(at)
    shape = file.read_sets(kinds.index(55))
    own = list(np.asarray(shape["node_nums"], int)).index(1)
    values = [abs(shape[f"r{k}"][own]) for k in (1, 2, 3)]
    assert values == pytest.approx(0.1 * AMPLITUDE, abs=1e-4)
    assert shape["freq"] == pytest.approx(5.0, abs=0.03)
    waveform = file.read_sets(kinds.index(58))
    assert (waveform["rsp_node"], waveform["rsp_dir"], len(waveform["data"])) == (1, 1, 24)
    assert np.abs(waveform["data"]).max() == pytest.approx(0.0008, rel=0.15)


def test_plots_and_the_animated_shape_are_pictures(out: Path) -> None:
    assert Image.open(out / "plots" / "ball.png").size[0] > 800
    assert "<svg" in (out / "plots" / "ball.svg").read_text()[:500]
    (shape,) = (out / "shapes").glob("*.gif")
    with Image.open(shape) as film:
        assert film.n_frames > 8
        first = np.asarray(film.convert("L"), float)
        film.seek(film.n_frames // 2)
        assert np.abs(np.asarray(film.convert("L"), float) - first).max() > 20


def test_a_kept_pass_gives_the_same_and_needs_no_pictures(
    run, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run.has_part("residuals")

    def read(*_: object) -> None:
        raise AssertionError("the pictures were read again")

    monkeypatch.setattr("tg4mm.show.measure.prepared.weighed", read)
    again = tmp_path / "again"
    words = [
        "measure",
        str(run.path),
        "--out",
        str(again),
        "--sensor",
        BALL_SPHERE,
        "--sensor",
        "all",
        "--no-animate",
    ]
    assert main(words) == 0
    assert (again / "series.csv").read_text() == (out / "series.csv").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sensor", "tip=sphere:9,9,9,0.1"], "holds no Gaussian"),
        (["--sensor", "tip=cube:1"], "is no region"),
        (["--sensor", "tip=pixel:nowhere,1,2"], "is no camera"),
        (["--sensor", "tip=pixel:r_000,999,2"], "outside the picture"),
        (["--sensor", "tip=cluster:9"], "no such cluster"),
        (["--sensor", "tip=all", "--reference", "tap"], "is no sensor"),
    ],
)
def test_what_cannot_be_measured_is_one_line(
    run, tmp_path: Path, capsys, words: list[str], message: str
) -> None:
    assert main(["measure", str(run.path), "--out", str(tmp_path / "out"), *words]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("tg4mm: ")
    assert message in line


def test_a_folder_of_something_else_is_left_alone(run, tmp_path: Path, capsys) -> None:
    (tmp_path / "letter.txt").write_text("mine")
    assert main(["measure", str(run.path), "--out", str(tmp_path), "--sensor", "all"]) == 2
    assert "holds no measure.json" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]
