"""A moving splat with everything that a format can hold, and readers of other people's making."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.core.splatfile.conftest import random_splat

NODE = Path(__file__).parent / "node"


@pytest.fixture
def splat():
    """60 Gaussians of degree 3, two modes, at a scale of 0.5 m a unit; all within what SPZ can hold."""
    made = random_splat(seed=3, n=60, k=16, m=2, n_timesteps=10)
    made.sh[:, 1:] = np.clip(0.2 * made.sh[:, 1:], -0.4, 0.4)
    made.sh[:, 0] = np.clip(made.sh[:, 0], -3.3, 3.3)
    return made


@pytest.fixture(scope="session")
def read_with_node():
    """Run node/<script> FILE, in this folder; the JSON it prints. Skips where npm's packages are not there."""
    if shutil.which("node") is None or not (NODE / "node_modules").is_dir():
        pytest.skip("needs node and npm's packages: make readers")

    def read(script, file):
        done = subprocess.run(["node", NODE / script, file], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return read


def turned(splat):
    """Unit quaternions wxyz [N, 4] as stored."""
    return splat.quats / np.linalg.norm(splat.quats, axis=1, keepdims=True)


def angles(a, b):
    """Degrees [N] between the rotations of unit quaternions [N, 4]."""
    return np.degrees(2 * np.arccos(np.clip(np.abs((a * b).sum(axis=1)), 0, 1)))
