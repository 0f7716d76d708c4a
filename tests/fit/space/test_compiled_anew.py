"""A process that compiles the kernels trains to the same bits as one that finds them in the cache."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.synthetic import make_synthetic_dataset

CODE = """
import sys
from pathlib import Path
from tg4mm.capture import load_capture, load_images
from tg4mm.run import Run
from tg4mm.fit.space import SpaceConfig, rest_views
from tg4mm.run.stages.space import train_space
data, out = Path(sys.argv[1]), Path(sys.argv[2])
capture = load_capture(data)
views = rest_views(capture, load_images(capture))
config = SpaceConfig(iterations=12, max_gaussians=700, init_points=600)
train_space(Run.create(out, data, "modal", {}), views, capture.points, config)
"""


@pytest.mark.slow
def test_what_is_compiled_anew_gives_the_same_bits(tmp_path: Path) -> None:
    make_synthetic_dataset(tmp_path / "data", n_views=4, n_timesteps=1, size=64, alphas=(), n_test=1)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    found = []
    for name in ("compiled", "cached"):
        before = set((tmp_path / "cache").rglob("*.nbc"))
        command = [sys.executable, "-c", CODE, str(tmp_path / "data"), str(tmp_path / name)]
        subprocess.run(command, check=True, env=environment, cwd=Path(__file__).parents[3])
        made = set((tmp_path / "cache").rglob("*.nbc")) - before
        assert bool(made) == (name == "compiled")
        found.append(_tensors(tmp_path / name / "space.safetensors"))
    assert found[0] == found[1]


def _tensors(path: Path) -> bytes:
    """The file without its header, which tells of the run."""
    raw = path.read_bytes()
    return raw[8 + int.from_bytes(raw[:8], "little") :]
