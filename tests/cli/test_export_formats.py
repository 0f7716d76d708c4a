"""`tg4mm export` in formats of other tools: options arrive, files hold the magnified motion or say that they do not."""

import gsply
import numpy as np
import pytest

from tests.helpers.splat_files import parsed
from tests.helpers.synthetic import moving_run
from tg4mm.cli import main
from tg4mm.core.splatfile import positions_at
from tg4mm.core.splatfile.formula import TURN
from tg4mm.run import Run
from tg4mm.show.export.splat import splat_of

N_TIMESTEPS = 12
TO_MOVE = "ply-sequence, spz, usd, gltf"


def made(root, n_timesteps=N_TIMESTEPS, freqs=(5.0,)):
    return moving_run(root, n_views=1, n_timesteps=n_timesteps, size=16, freqs=freqs)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """5 Hz at 30 Hz: a period is 6 of 12 timesteps."""
    return made(tmp_path_factory.mktemp("formats"))


@pytest.fixture(scope="module")
def splat(run):
    return splat_of(run)


def export(run, out, format, *options):
    return main(["export", str(run.path), "--out", str(out), "--format", format, *options])


def test_spz_is_one_file_at_rest(run, splat, tmp_path, capsys):
    assert export(run, tmp_path / "deep" / "a.spz", "spz") == 0
    printed = capsys.readouterr()
    assert printed.out == f"{tmp_path}/deep/a.spz\n"
    assert "spz holds no motion: this is the scene at rest" in printed.err
    read = gsply.read_spz(str(tmp_path / "deep" / "a.spz"))
    np.testing.assert_allclose(read.means @ TURN, splat.means, atol=1e-6)


def test_spz_is_a_sequence_of_one_period(run, splat, tmp_path, capsys):
    assert export(run, tmp_path / "frames", "spz", "--alpha", "20", "--band", "4", "6") == 0
    assert "spz holds no motion: 6 files, one for each timestep" in capsys.readouterr().err
    files = sorted(path.name for path in (tmp_path / "frames").glob("*.spz"))
    assert files == [f"frame_{t:04d}.spz" for t in range(6)]
    for t in (0, 2, 5):
        read = gsply.read_spz(str(tmp_path / "frames" / f"frame_{t:04d}.spz"))
        np.testing.assert_allclose(read.means @ TURN, positions_at(splat, t, 20.0), atol=1e-5)


def test_gltf_holds_the_band_magnified(run, splat, tmp_path):
    for name, options in (("in", ("4", "6")), ("out", ("1", "2"))):
        band = ["--band", *options, "--allow-empty-band"]
        assert export(run, tmp_path / f"{name}.glb", "gltf", "--alpha", "20", *band) == 0
    factors = []
    for name in ("in", "out"):
        document, array = parsed(tmp_path / f"{name}.glb")
        targets = [array(t["POSITION"]) for t in document["meshes"][0]["primitives"][0]["targets"]]
        factors.append(np.abs(np.array(targets)).sum() / np.abs(splat.displacement[0].view(np.float32)).sum())
    np.testing.assert_allclose(factors, [21.0, 1.0], rtol=1e-5)


def test_lengths_that_are_a_guess_are_said(tmp_path, capsys):
    run = made(tmp_path)
    scene = run.dataset / "scene.json"
    scene.write_text(scene.read_text().replace('"unit_scale_m": 0.1', '"unit_scale_m": null'))
    for name, format in (("a.usdc", "usd"), ("a.glb", "gltf")):
        assert export(run, tmp_path / name, format) == 0
        assert "the scale is not known: one scene unit is written as one metre" in capsys.readouterr().err


def test_a_run_without_motion_is_exported_at_rest(run, tmp_path, capsys):
    still = Run.create(tmp_path / "still", run.dataset, "modal", {})
    still.save_space(run.load_space(), {})
    for name, format in (("a.glb", "gltf"), ("a.usdc", "usd"), ("a.spz", "spz"), ("frames", "spz")):
        assert export(still, tmp_path / name, format) == 0
    document, _ = parsed(tmp_path / "a.glb")
    assert "animations" not in document
    assert len(list((tmp_path / "frames").glob("*.spz"))) == 1
    capsys.readouterr()
    assert export(still, tmp_path / "b.glb", "gltf", "--alpha", "3") == 2
    assert "has no motion: only --alpha 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("out", "options", "message"),
    [
        (
            "a.ply",
            "ply --alpha 3",
            f"--alpha belongs to --format {TO_MOVE}; a splat file contains the motion",
        ),
        ("a.html", "html --band 1 2", f"--band belongs to --format {TO_MOVE}; a page contains the motion"),
        (
            "a.glb",
            "gltf --method linear",
            "--method belongs to --format ply-sequence, spz, usd; a .glb contains",
        ),
        ("a.glb", "gltf --timesteps 3", "--timesteps belongs to --format ply-sequence, spz, usd"),
        ("a.spz", "spz --alpha 3", "a .spz file contains the scene at rest; give a folder"),
        ("a.usdc", "usd --timesteps 3-12", "timestep 12 is outside 0 … 11"),
        ("a.usdc", "usd --timesteps 3,x", "--timesteps '3,x': 'x' is neither a timestep such as 7"),
        ("a.usdc", "usd --timesteps 5-3", "--timesteps '5-3': '5-3' is neither a timestep such as 7"),
        (
            "a.usdc",
            "usd --timesteps 0-99999999999",
            "is neither a timestep such as 7 nor a range such as 0-9",
        ),
        ("a.gltf", "gltf", "expected a name that ends in .glb, such as {}/a.glb"),
        ("a.abc", "usd", "expected a name that ends in .usdc, such as {}/a.usdc"),
        ("a.usdc", "usd --alpha nan", "must be a finite number"),
        ("a.glb", "gltf --alpha 3 --band 1 20", "half the frame rate"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(run, tmp_path, capsys, out, options, message):
    assert export(run, tmp_path / out, *options.split()) == 2
    printed = capsys.readouterr().err
    assert message.replace("{}", str(tmp_path)) in printed
    assert printed.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "format", "kind"), [("a.ply", "ply", "PLY"), ("a.glb", "gltf", "GLB"), ("a.usda", "usd", "USDA")]
)
def test_a_file_of_another_kind_is_not_replaced(run, tmp_path, capsys, name, format, kind):
    (tmp_path / name).write_text("mine")
    assert export(run, tmp_path / name, format) == 2
    assert f"exists, and is no {kind} file; choose another name" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "mine"
    (tmp_path / name).unlink()
    for _ in range(2):
        assert export(run, tmp_path / name, format) == 0
