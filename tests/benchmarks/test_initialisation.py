"""benchmarks/initialisation.py: a row for each start, kept as soon as it is there, and refused under other settings."""

import json

import pytest

from benchmarks import initialisation
from benchmarks.__main__ import main
from benchmarks.initialisation import HEADER
from tests.helpers.synthetic import make_synthetic_dataset

STARTS = "points,random"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("initialisation") / "data"
    make_synthetic_dataset(path, n_views=6, n_timesteps=2, size=48, alphas=(), n_test=2)
    return path


@pytest.fixture(scope="module")
def out(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("rows") / "out"
    assert main(arguments(data, out, "--pictures")) == 0
    return out


def arguments(data, out, *more):
    return ["initialisation", str(data), "--out", str(out), "--inits", STARTS, "--iterations", "40", *more]


def test_each_start_leaves_its_figures(out):
    points, random = (json.loads((out / "data" / f"{s}.json").read_text()) for s in STARTS.split(","))
    assert (points["source"], random["source"]) == ("points", "random")
    assert points["found"] >= points["taken"] > 0
    assert random["found"] == 0
    assert 100 <= random["taken"] < points["taken"]
    # points on the surfaces fit better than a box full of random ones, which is what the table is there to show
    assert points["psnr"] > random["psnr"] + 1
    assert 0 < points["start_s"] <= points["seconds"]


def test_a_second_run_trains_nothing(data, out, capsys, monkeypatch):
    monkeypatch.setattr(initialisation, "measured", None)
    assert main(arguments(data, out)) == 0
    said = capsys.readouterr().out
    assert said.count("| data ") == 2
    assert said.count("mean of 1") == 2
    assert all(name in said for name in HEADER)


def test_other_settings_are_refused_in_one_line(data, out, capsys):
    assert main([*arguments(data, out), "--seed", "1"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "points.json was made with other settings; choose another --out" in said[0]
