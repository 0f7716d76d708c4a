"""Points and poses from pictures of our own generator, whose cameras and surfaces are exact. Slow: it renders."""

import subprocess
import sys

import pytest

from tg4mm.capture import load_capture
from tg4mm.cli import main
from tg4mm.run.train import train
from tg4mm.show.result import result_of

pytestmark = pytest.mark.slow


def generated(out, repo_root, options):
    """The lego scene by `python -m dataset_gen`, with one test camera."""
    pytest.importorskip("bpy")
    pytest.importorskip("pycolmap")
    options += " --test-views 1 --alphas 5 --truth none"
    command = [sys.executable, "-m", "dataset_gen", "lego", "--out", str(out), *options.split()]
    done = subprocess.run(command, cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return next(out.glob("lego_*"))


def test_the_video_of_a_tripod_tells_the_frequency(tmp_path, repo_root):
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
    found, *others = result_of(run).vibrations
    assert found.hz == pytest.approx(3.0, abs=0.1)
    assert all(v.hz == pytest.approx(10.0, abs=0.1) for v in others)  # lego's second, fainter mode
