"""`tg4mm render SPLAT.ply --cameras FILE`: a splat file is rendered as the run that it was exported from."""

import numpy as np
import pytest
from PIL import Image

from tg4mm.cli import main
from tg4mm.run import Run


def cameras_of(run_path):
    return Run.open(run_path).dataset / "000" / "transforms_test.json"


def rendered(what, out, cameras, *options):
    """[T, H, W, 3] of the first camera."""
    common = ["--cameras", str(cameras), "--out", str(out), "--no-video", *options]
    assert main(["render", str(what), *common]) == 0
    return np.array([np.asarray(Image.open(p)) / 255 for p in sorted(out.glob("*/r_000.png"))])


def psnr(a, b):
    return float(-10 * np.log10(max(((a - b) ** 2).mean(), 1e-12)))


@pytest.mark.parametrize("low_pass", ["none", "baked"])
def test_a_splat_file_is_rendered_as_its_run(run_path, tmp_path, low_pass):
    cameras, file = cameras_of(run_path), tmp_path / "a.ply"
    assert main(["export", str(run_path), "--out", str(file), "--low-pass", low_pass]) == 0
    options = ("--alpha", "20", "--band", "4", "6", "--allow-empty-band")
    of_run, of_file = (rendered(what, tmp_path / what.stem, cameras, *options) for what in (run_path, file))
    # With the low-pass in its scales a Gaussian is as wide as at the mean distance of the cameras.
    assert psnr(of_run, of_file) > (55 if low_pass == "none" else 35)
    still = rendered(file, tmp_path / "still", cameras, "--alpha", "0")
    assert psnr(of_run, still) < psnr(of_run, of_file) - 6


@pytest.mark.parametrize("options", [[], ["--split", "test"], ["--orbit", "4"]])
def test_a_splat_file_has_no_cameras(run_path, tmp_path, capsys, options):
    file = tmp_path / "a.ply"
    main(["export", str(run_path), "--out", str(file)])
    assert main(["render", str(file), "--alpha", "0", "--out", str(tmp_path / "out"), *options]) == 2
    said = capsys.readouterr().err.splitlines()
    assert "a.ply is a splat file, which has no cameras: give --cameras FILE" in said[-1]
    assert not (tmp_path / "out").exists()


def test_what_is_no_splat_file_is_one_line(run_path, tmp_path, capsys):
    (tmp_path / "a.ply").write_bytes(b"ply\n")
    out = tmp_path / "out"
    assert main(["render", str(tmp_path / "a.ply"), "--alpha", "0", "--out", str(out)]) == 2
    assert "a.ply: header has no end_header" in capsys.readouterr().err
    assert not out.exists()


def test_pictures_of_another_file_are_not_mixed_in(run_path, tmp_path, capsys):
    cameras, out = cameras_of(run_path), tmp_path / "out"
    for name, low_pass in (("a", "none"), ("b", "baked")):
        main(["export", str(run_path), "--out", str(tmp_path / f"{name}.ply"), "--low-pass", low_pass])
    rendered(tmp_path / "a.ply", out, cameras, "--alpha", "0")
    again = ["render", str(tmp_path / "b.ply"), "--alpha", "0", "--cameras", str(cameras), "--out", str(out)]
    assert main(again) == 2
    assert "out was made of another model: give another folder" in capsys.readouterr().err
