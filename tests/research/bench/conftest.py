"""A tiny dataset with exact truth, and settings that train it in a second."""

import pytest

from tests.helpers.synthetic import make_synthetic_dataset

MODAL = {
    "space.iterations": "60", "space.max_gaussians": "400", "space.init_points": "300", "motion.iterations": "4",
    "motion.components": "2",
}  # fmt: skip
PAPER = {
    "space.max_gaussians": "400", "space.init_points": "300", "paper.warm_up": "40", "paper.iterations": "80",
    "paper.motion_iterations": "4", "paper.channels": "2", "paper.resolution": "16",
}  # fmt: skip


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "sway_5Hz_0_02"
    make_synthetic_dataset(path, n_views=5, n_timesteps=6, size=32, freqs=(5.0,), alphas=(5, 20), n_test=1)
    return path
