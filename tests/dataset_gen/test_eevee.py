"""EEVEE without a display: the same picture as Cycles' in outline, repeatable, and truth stays Cycles'."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")
pytest.importorskip("OpenEXR")

ROOT = Path(__file__).resolve().parents[2]

# In a process of its own: without OpenGL Blender does not raise but ends the process.
RENDER = """
import sys
from pathlib import Path
import numpy as np
from dataset_gen import build, render
from dataset_gen.cameras import train_cameras
from dataset_gen.settings import Quality
from dataset_gen.scenes import SCENES

out = Path(sys.argv[1])
stage = build.build(SCENES["mic"]())
made = {}
for engine in ("cycles", "eevee"):
    quality = Quality(48, 48, samples=16, seed=0, threads=1, engine=engine)
    render.configure(stage, quality)
    build.set_view(stage, train_cameras(30)[5])
    made[engine] = render.linear_picture(stage)
    render.use_data(stage)
    made[engine + "_depth"] = render.data_passes(stage)["Depth"]
    render.use_picture(stage, quality)
    made[engine + "_again"] = render.linear_picture(stage)
np.savez(out / "made.npz", **made)
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("eevee")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", RENDER, str(out)], capture_output=True, text=True, env=environment, timeout=900
    )
    if not (out / "made.npz").exists():
        last = (done.stdout + done.stderr).strip().splitlines()[-1:]
        if done.returncode < 0 or any(word in done.stderr + done.stdout for word in ("EGL", "OpenGL")):
            pytest.skip(f"no OpenGL here: {last}")
        pytest.fail(done.stderr)
    with np.load(out / "made.npz", allow_pickle=False) as data:
        return dict(data)


@pytest.mark.slow
def test_eevee_draws_the_same_outline_with_a_filter_as_narrow(made):
    ours, theirs = made["eevee"][..., 3], made["cycles"][..., 3]
    assert 0.05 < theirs.mean() < 0.5
    assert np.abs(ours - theirs).mean() < 0.012
    partial = [((a > 0.05) & (a < 0.95)).sum() for a in (ours, theirs)]
    assert partial[0] < 1.25 * partial[1]  # no wider edges


@pytest.mark.slow
def test_both_engines_repeat_themselves_after_data_passes_that_do_not_differ(made):
    for engine in ("cycles", "eevee"):
        np.testing.assert_array_equal(made[engine], made[f"{engine}_again"])
    np.testing.assert_array_equal(made["eevee_depth"], made["cycles_depth"])
