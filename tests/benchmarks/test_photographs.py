"""benchmarks/photographs.py: it holds out what it says, spoils by gains that it knows, and prints what it measured."""

import re

from PIL import Image

from benchmarks.__main__ import main
from tests.helpers.synthetic import make_synthetic_dataset


def test_it_prints_its_figures_and_leaves_pictures(tmp_path, capsys):
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


def test_an_unknown_setting_is_one_line(tmp_path, capsys):
    assert main(["photographs", str(tmp_path), "--set", "space.level=2"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(
        "benchmarks photographs: setting 'space.level' is unknown; did you mean space.levels?"
    )
    assert error.count("\n") == 1
