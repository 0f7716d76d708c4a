"""benchmarks/initialisation.py: a row for each start, kept as soon as it is there, and refused under other settings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import initialisation
from benchmarks.__main__ import main
from benchmarks.initialisation import HEADER, cells, means, sheet
from tests.helpers.synthetic import make_synthetic_dataset

STARTS = "points,random"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("initialisation") / "data"
    make_synthetic_dataset(path, n_views=6, n_timesteps=2, size=48, alphas=(), n_test=2)
    return path


@pytest.fixture(scope="module")
def out(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rows") / "out"
    assert main(arguments(data, out, "--pictures")) == 0
    return out


def arguments(data: Path, out: Path, *more: str) -> list[str]:
    return ["initialisation", str(data), "--out", str(out), "--inits", STARTS, "--iterations", "40", *more]


def test_each_start_leaves_its_figures(out: Path) -> None:
    points, random = (json.loads((out / "data" / f"{s}.json").read_text()) for s in STARTS.split(","))
    assert (points["source"], random["source"]) == ("points", "random")
    assert points["found"] >= points["taken"] > 0
    assert random["found"] == 0
    assert 100 <= random["taken"] < points["taken"]
    # points on the surfaces fit better than a box full of random ones, which is what the table is there to show
    assert points["psnr"] > random["psnr"] + 1
    assert 0 < points["start_s"] <= points["seconds"]


def test_the_pictures_are_render_truth_and_difference(out: Path) -> None:
    files = sorted(p.name for p in (out / "data").glob("*.png"))
    assert files == ["points_0.png", "points_1.png", "random_0.png", "random_1.png"]
    grow = round(256 / 48)
    assert Image.open(out / "data" / "points_0.png").size == (3 * 48 * grow, 48 * grow)
    grey, white = np.full((256, 4, 3), 0.5), np.ones((256, 4, 3))
    parts = np.asarray(sheet(grey, white)).reshape(256, 3, 4, 3)
    assert [int(parts[:, k].max()) for k in range(3)] == [128, 255, 255]


def test_a_second_run_trains_nothing(
    data: Path, out: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(initialisation, "measured", None)
    assert main(arguments(data, out)) == 0
    said = capsys.readouterr().out
    assert said.count("| data ") == 2
    assert said.count("mean of 1") == 2
    assert all(name in said for name in HEADER)


def test_other_settings_are_refused_in_one_line(
    data: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments(data, out), "--seed", "1"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "points.json was made with other settings; choose another --out" in said[0]


def test_an_unknown_start_is_refused(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["initialisation", str(data), "--out", str(tmp_path), "--inits", "hull,cloud"]) == 2
    assert "--inits: 'cloud' is none of auto, points, sfm, hull, random" in capsys.readouterr().err


def test_means_are_over_the_sets_and_a_fallback_is_named() -> None:
    row = {"set": "a", "start": "sfm", "source": "hull (sfm found 3 points)", "found": 10, "taken": 4}
    row |= {"gaussians": 8, "psnr": 30.0, "ssim": 0.9, "start_s": 1.0, "seconds": 2.0}
    other = row | {"set": "b", "source": "sfm (20 points)", "psnr": 34.0, "found": 20}
    assert cells(row)[1] == "sfm → hull (sfm found 3 points)"
    assert cells(other)[1] == "sfm"
    assert means([row, other]) == [["mean of 2", "sfm", "15", "4", "8", "32.00", "0.9000", "1.0", "2.0"]]
