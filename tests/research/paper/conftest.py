"""A tiny `paper` run, trained once."""

import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.run.train import train

N_TIMESTEPS, SIZE = 6, 32
SETTINGS = {
    "paper.channels": "4", "paper.resolution": "16", "paper.iterations": "140", "paper.warm_up": "60",
    "paper.motion_iterations": "60", "paper.learning_rate": "3e-3", "paper.motion_learning_rate": "1e-3",
    "paper.difference": "false", "space.max_gaussians": "400",
}  # fmt: skip


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("paper") / "sway_5Hz_0_03"
    make_synthetic_dataset(
        path, n_views=4, n_timesteps=N_TIMESTEPS, size=SIZE, freqs=(5.0,), amplitude=0.03, alphas=(5,)
    )
    return path


@pytest.fixture(scope="session")
def trained(data):
    return train(data, data.parent / "run", "paper-tuned", settings=SETTINGS)
