"""The command on a CSV file and on a measurement: files out, and one line for what is wrong."""

import csv
import json

import numpy as np
import pytest

from tests.show.analyse.systems import driven, two_masses
from tg4mm.cli.program import main


def write(path, head, *columns):
    np.savetxt(path, np.stack(columns, 1), delimiter=",", header=head, comments="", fmt="%.9g")
    return path


@pytest.fixture
def film(tmp_path):
    values, *_ = two_masses(600, 60.0, 1)
    noise = 0.01 * np.random.default_rng(0).normal(size=(600, 2))
    a, b = (values + noise).T
    sure = np.full(600, 0.01)
    head = "time_s,tip/x_mm,tip/x_mm_deviation,tip/y_mm,tip/y_mm_deviation"
    return write(tmp_path / "film.csv", head, np.arange(600) / 60, a, sure, b, sure)


def test_everything_of_a_csv_file(film, tmp_path, capsys):
    pytest.importorskip("pyoma2", reason="the extra `modal` is not installed")
    out = tmp_path / "out"
    words = ["analyse", str(film), "--out", str(out), "--band", "1", "25", "--modes", "--against", str(film)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "SSI-cov" in said
    assert "mm/s" in said
    assert " changed\n" not in said.partition("difference")[2]
    found = json.loads((out / "analysis.json").read_text())
    rows = list(csv.DictReader((out / "levels.csv").open()))
    rms = next(r for r in rows if (r["channel"], r["quantity"], r["figure"]) == ("tip/x", "velocity", "rms"))
    (level,) = [v for v in found["levels"] if (v["channel"], v["quantity"]) == ("tip/x", "velocity")]
    assert (rms["unit"], float(rms["value"])) == ("mm/s", pytest.approx(level["rms"]["value"]))
    assert float(rms["deviation"]) > 0
    assert (out / "psd.csv").exists()
    bands = list(csv.DictReader((out / "third_octaves.csv").open()))
    assert {r["quantity"] for r in bands} == {"displacement", "velocity", "acceleration"}
    assert {p.name for p in (out / "plots").iterdir()} >= {"tip_x.png", "stabilisation_SSI-cov.png"}
    assert any(p.name.startswith("orbit") for p in (out / "plots").iterdir())
    assert (
        main(["analyse", str(film), "--out", str(out), "--channel", "tip/x"]) == 0
    )  # anew, without the rest
    assert {p.name for p in (out / "plots").iterdir()} == {"tip_x.png", "third_octaves_tip_x.png"}
    assert not (out / "stabilisation.csv").exists()


def test_a_hammer_beside_the_film(tmp_path, capsys):
    pytest.importorskip("sdypy.EMA", reason="the extra `modal` is not installed")
    pytest.importorskip("pyoma2", reason="the extra `modal` is not installed")
    fast = np.arange(0, 20, 1 / 960)
    force = np.zeros(len(fast))
    for hit in (2.0, 7.1, 14.4):
        force += 50 * np.exp(-(((fast - hit) / 0.01) ** 2))
    moved = driven(force, 960.0)[::16]
    noise = 0.002 * np.random.default_rng(0).normal(size=len(moved))
    head = "time_s,tip_mm,tip_mm_deviation"
    film = write(tmp_path / "film.csv", head, fast[::16] + 0.35, moved + noise, np.full(len(moved), 0.002))
    push = np.gradient(np.gradient(driven(force, 960.0), 1 / 960), 1 / 960) / 1000
    hammer = write(tmp_path / "hammer.csv", "time [s],force [N],acc [m/s²]", fast, force, push)
    words = ["analyse", str(film), "--out", str(tmp_path / "out"), "--with", str(hammer), "--input", "force"]
    words += ["--window", "boxcar", "--segment", "6", "--modes", "--band", "3", "18"]
    assert main(words) == 2
    assert "force, which cannot determine the lag: name an accelerometer" in capsys.readouterr().err
    assert main([*words, "--sync", "acc"]) == 0
    found = json.loads((tmp_path / "out" / "analysis.json").read_text())
    (transfer,) = found["transfers"]
    assert transfer["lag_s"]["value"] == pytest.approx(0.35, abs=0.002)
    assert transfer["freqs_hz"][int(np.argmax(transfer["h1"]["size"]))] == pytest.approx(8, abs=0.2)
    assert any(abs(m["frequency_hz"]["value"] - 8) < 0.1 for m in found["modes"][-1]["modes"])
    (curve,) = found["curves"]
    assert curve["ratio"]["value"] == pytest.approx(
        1, abs=0.003
    )  # the differences of `push` take a thousandth
    rows = list(csv.DictReader((tmp_path / "out" / "reference.csv").open()))
    assert {(r["channel"], r["instrument"], r["unit"]) for r in rows} == {("tip", "acc", "mm/s²")}


@pytest.mark.parametrize(
    ("content", "words", "message"),
    [
        ("a_mm,b_mm\n1,2\n", [], "has no column of times"),
        ("time_s,a_mm\n0,1\n1,x\n", [], "row 3: 'x' is no number"),
        ("time_s,a_mm\n0,1\n1\n", [], "row 3: 1 values, expected 2"),
        ("time_s,a_mm\n" + "".join(f"{k},1\n" for k in range(20)) + "19,1\n", [], "times do not increase at 19 s"),
        ("time_s,a_mm\n" + "".join(f"{k**4},1\n" for k in range(20)), [], "times have gaps"),
        ("time_s,a_mm\n0,1\n1,inf\n", [], "not a finite number"),
        ("", [], "holds no rows"),
        (None, ["--channel", "nose"], "is not in"),
        (None, ["--band", "40", "50"], "no part of the band"),
        (None, ["--overlap", "1"], "--overlap 1, expected"),
        (None, ["--window", "square"], "is unknown to scipy"),
        (None, ["--segment", "99"], "a segment of 5940 samples"),
        (None, ["--machine-class", "V"], "is unknown; classes: I, II"),
        (None, ["--lag", "0"], "belong to --with"),
        (None, ["--with", "FILM"], "--input names one of them"),
        (None, ["--with", "FILM", "--input", "z"], "is no column of"),
        (None, ["--with", "FILM", "--input", "tip/x", "--sync", "z"], "is no column of"),
        (None, ["--with", "FILM", "--input", "tip/y", "--lag", "100"], "share 0 samples"),
        (None, ["--against", "nowhere"], "nowhere does not exist"),
        (None, ["--against", "."], "neither a CSV file nor a folder"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line_and_nothing_is_written(film, tmp_path, capsys, content, words, message):
    if content is not None:
        film = tmp_path / "bad.csv"
        film.write_text(content)
    out = tmp_path / "out"
    own = [str(film) if w == "FILM" else w for w in words]
    assert main(["analyse", str(film), "--out", str(out), *own]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-1].startswith("tg4mm: ")
    assert message in lines[-1]
    assert not out.exists()
