"""What the tests in the real program share: the built extension, a small splat file, Blender on a screen."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tg4mm.core.splatfile import SplatFile, write_splat
from tg4mm.core.splatfile.model import f_dc

from . import session

SPLAT = "drum.ply"


def drum(side=24, freqs_hz=(2.0, 5.0)):
    """A square membrane of side × side Gaussians, 2 units wide, in modes (1, 1), (2, 1) …, one a frequency."""
    line = np.linspace(-1.0, 1.0, side)
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    n = len(x)
    shapes = [
        np.sin(np.pi * (k + 1) * (x + 1) / 2) * np.sin(np.pi * (y + 1) / 2) for k in range(len(freqs_hz))
    ]
    displacement = np.zeros((len(freqs_hz), n, 3), dtype=np.complex64)
    for k, shape in enumerate(shapes):
        displacement[k, :, 2] = 0.02 / (k + 1) * shape
    colour = np.stack([(x + 1) / 2, (y + 1) / 2, np.full(n, 0.3)], axis=1)
    means, quats = np.stack([x, y, np.zeros(n)], axis=1), np.tile([1, 0, 0, 0], (n, 1))
    rest = (means, quats, np.full((n, 3), 0.6 / side), np.full(n, 0.9), f_dc(colour)[:, None])
    still = SplatFile.static(*(part.astype(np.float32) for part in rest), unit_scale_m=0.1)
    phasors = {"displacement": displacement, "rotation": np.zeros_like(displacement)}
    return replace(still, **phasors, freqs_hz=np.array(freqs_hz), fps=24.0, n_timesteps=48)


@pytest.fixture(scope="session")
def pictures(tmp_path_factory):
    """Where the screenshots go: $TG4MM_GUI_PICTURES, else a temporary folder."""
    folder = os.environ.get("TG4MM_GUI_PICTURES")
    return Path(folder) if folder else tmp_path_factory.mktemp("pictures")


@pytest.fixture(scope="session")
def extension_zip(repo_root, tmp_path_factory):
    """The zip as `make extension` builds it."""
    subprocess.run([sys.executable, "addon/make_extension.py"], cwd=repo_root, check=True)
    return max((repo_root / "dist").glob("tg4mm-*.zip"), key=lambda path: path.stat().st_mtime)


@pytest.fixture(scope="session")
def splat_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("splat") / SPLAT
    write_splat(path, drum())
    return path


@pytest.fixture(scope="module")
def blender(extension_zip, splat_file):
    """One Blender for the tests of a module, which go on from each other's state, in their order."""
    with session.Session.start(extension_zip, [splat_file]) as running:
        yield running
