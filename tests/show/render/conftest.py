"""A run whose model is exactly the one its dataset was rendered from."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.run import Run

N_TIMESTEPS = 6


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data") / "sway_5Hz_0_02"
    make_synthetic_dataset(path, n_views=3, n_timesteps=N_TIMESTEPS, size=32, freqs=(5.0,), alphas=(20,))
    return path


@pytest.fixture
def run(dataset: Path, tmp_path: Path) -> Run:
    gaussians, motion = make_synthetic_dataset(
        tmp_path / "model", n_views=0, n_timesteps=N_TIMESTEPS, size=32, freqs=(5.0,), n_test=0
    )
    made = Run.create(tmp_path / "run", dataset, "modal", {"seed": 0})
    made.save_space(gaussians, {"seconds": 1.0})
    made.save_motion(motion, {"seconds": 2.0})
    return made


@pytest.fixture
def still_run(run: Run, dataset: Path, tmp_path: Path) -> Run:
    """The same without motion."""
    made = Run.create(tmp_path / "still", dataset, "modal", {"seed": 0})
    made.save_space(run.load_space(), {"seconds": 1.0})
    return made
