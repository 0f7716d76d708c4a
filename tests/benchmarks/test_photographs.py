"""benchmarks/photographs.py: it holds out what it says, spoils by gains that it knows, and prints what it measured."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.__main__ import main
from benchmarks.photographs import chosen, spoilt, with_best_gain
from tests.fit.space.scenes import intrinsics, orbit, views_of
from tests.helpers.synthetic import make_synthetic_dataset


def test_it_prints_its_figures_and_leaves_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    make_synthetic_dataset(data, n_views=6, n_timesteps=1, size=64, alphas=(), n_test=0)
    settings = [f"--set=space.{s}" for s in ("iterations=60", "max_gaussians=900", "gains=true")]
    assert (
        main(["photographs", str(data), "--shrink", "2", "--spoil", "0.1", "--out", str(out), *settings]) == 0
    )
    text = capsys.readouterr().out
    assert "32×32, 5 pictures, 1 held out" in text
    plain, fitting = (float(f) for f in re.findall(r"([\d.]+) dB", text))
    assert plain > 20
    assert abs(fitting - plain) < 1
    assert re.search(r"gains: deviation 0\.\d+ given, 0\.\d+ from what was found", text)
    assert sorted(p.name for p in out.iterdir()) == ["between.png", "held_out_0.png"]
    assert Image.open(out / "between.png").size == (32, 32)


def test_an_unknown_setting_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["photographs", str(tmp_path), "--set", "space.level=2"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(
        "benchmarks photographs: setting 'space.level' is unknown; did you mean space.levels?"
    )
    assert error.count("\n") == 1


def test_views_are_chosen_and_spoilt_as_asked() -> None:
    rgb = np.full((3, 8, 8, 3), 0.4)
    views = views_of(orbit(3, np.zeros(3)), intrinsics(8), np.ones((3, 8, 8)), rgb)
    some = chosen(views, np.array([True, False, True]))
    np.testing.assert_array_equal(some.viewmats, views.viewmats[[0, 2]])
    assert [int(rows[0]) for rows in some.images] == [0, 2]
    changed, gains = spoilt(views, 0.1)
    np.testing.assert_allclose(changed.rgb[:, 0, 0], 0.4 * gains, rtol=1e-6)
    np.testing.assert_allclose(np.log(gains).mean(0), 0, atol=1e-6)
    np.testing.assert_allclose(with_best_gain(0.5 * rgb[0], rgb[0]), rgb[0], rtol=1e-5)
