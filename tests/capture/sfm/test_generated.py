"""Points and poses from pictures of our own generator, whose cameras and surfaces are exact. Slow: it renders."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.capture.sfm import SfmPoints, triangulate_views
from tg4mm.cli import main
from tg4mm.fit.space.targets import rest_views
from tg4mm.run.train import train
from tg4mm.show.result import result_of

pytestmark = pytest.mark.slow


def generated(out: Path, repo_root: Path, options: str) -> Path:
    """The lego scene by `python -m dataset_gen`, with one test camera."""
    pytest.importorskip("bpy")
    pytest.importorskip("pycolmap")
    options += " --test-views 1 --alphas 5 --truth none"
    command = [sys.executable, "-m", "dataset_gen", "lego", "--out", str(out), *options.split()]
    done = subprocess.run(command, cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return next(out.glob("lego_*"))


@pytest.fixture(scope="module")
def lego(tmp_path_factory: pytest.TempPathFactory, repo_root: Path) -> Capture:
    options = "--views 20 --size 224 --samples 12 --timesteps 1"
    return load_capture(generated(tmp_path_factory.mktemp("generated"), repo_root, options))


@pytest.fixture(scope="module")
def found(lego: Capture) -> SfmPoints:
    return triangulate_views(rest_views(lego, load_images(lego)))


def test_points_lie_on_the_surface(lego: Capture, found: SfmPoints) -> None:
    """Measured against points3d.ply: 20,000 points on the surfaces, so a point on one is half a spacing off."""
    assert lego.points is not None
    tree = cKDTree(lego.points.xyz)
    spacing = np.median(tree.query(lego.points.xyz, k=2)[0][:, 1])
    pixel = 4 / lego.Ks[0, 0, 0]
    distance, _ = tree.query(found.xyz)
    assert len(found) >= 100
    assert np.median(distance) < 2 * pixel + spacing
    assert np.quantile(distance, 0.9) < 6 * pixel + spacing
    shifted, _ = tree.query(found.xyz + np.float32(10 * pixel))
    assert np.median(shifted) > np.median(distance)


def test_colours_are_the_surfaces(lego: Capture, found: SfmPoints) -> None:
    assert lego.points is not None
    _, nearest = cKDTree(lego.points.xyz).query(found.xyz)
    error = np.abs(lego.points.rgb[nearest].astype(int) - found.rgb).mean()
    shuffled = np.random.default_rng(0).permutation(found.rgb)
    assert error < 0.8 * np.abs(lego.points.rgb[nearest].astype(int) - shuffled).mean()


def test_the_video_of_a_tripod_tells_the_frequency(tmp_path: Path, repo_root: Path) -> None:
    """From H.264 and photographs without poses, as a person has them, to the scene's 3 Hz."""
    options = (
        "--cameras sweep --views 40 --size 256 --samples 6 --timesteps 24 --fps 24 --amplitude-px 0.8 --frequency 3 "
        "--codec h264 --keep-video --crf 14 --background white --images png8 --points 0"
    )
    made = generated(tmp_path, repo_root, options)
    assert main(["sfm", str(made / "video"), "--out", str(tmp_path / "data")]) == 0
    capture = load_capture(tmp_path / "data")
    assert (capture.kind, capture.n_timesteps, capture.fps) == ("tripod", 24, 24.0)
    assert len(capture) - 24 >= 15  # photographs placed; the others have too little texture at this size
    run = train(tmp_path / "data", tmp_path / "run", settings={"space.iterations": "600"})
    (found,) = result_of(run).vibrations
    assert found.hz == pytest.approx(3.0, abs=0.1)
