"""Random Gaussians and modes for a run, a copy of one, and the error that a run refuses with."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from tg4mm.core.errors import RunError
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run

SETTINGS = {"seed": 0, "iterations": 100, "band_hz": [4.0, 6.0], "size": None}


def gaussians(n: int = 7, seed: int = 0) -> Gaussians:
    g = torch.Generator().manual_seed(seed)
    means, quats = torch.randn(n, 3, generator=g), torch.randn(n, 4, generator=g)
    scales, opacities = torch.rand(n, 3, generator=g), torch.rand(n, generator=g)
    return Gaussians(means, quats, scales, opacities, torch.randn(n, 4, 3, generator=g))


def modal(n: int = 7, k: int = 2) -> ModalMotion:
    rng = np.random.default_rng(1)
    draw = lambda: (rng.normal(size=(k, n, 3)) + 1j * rng.normal(size=(k, n, 3))).astype(np.complex64)  # noqa: E731
    return ModalMotion.of_phasors(np.arange(1.0, k + 1), draw(), draw(), fps=30.0, n_timesteps=30)


def made_run(path: Path, dataset: Path, space: Gaussians, motion: ModalMotion | None, preset="modal") -> Run:
    """A run whose stages gave this."""
    run = Run.create(path, dataset, preset, {})
    run.save_space(space, {})
    if motion is not None:
        run.save_motion(motion, {})
    return run


def refused(match: str) -> pytest.RaisesExc:
    """RunError whose message is one line and matches."""
    return pytest.raises(RunError, match=r"\A[^\n]*" + match + r"[^\n]*\Z")


def copied(run: Run, path: Path) -> Run:
    """The run in a new folder `path`; its dataset stays where it is."""
    return Run.open(shutil.copytree(run.path, path))
