"""A run whose model is exactly the one its dataset was rendered from."""

import pytest

from tests.helpers.synthetic import exact_run
from tg4mm.run import Run

N_TIMESTEPS = 6


@pytest.fixture(scope="session")
def exact(tmp_path_factory):
    scene = {"n_views": 3, "n_timesteps": N_TIMESTEPS, "size": 32, "freqs": (5.0,)}
    return exact_run(tmp_path_factory.mktemp("exact"), **scene, alphas=(20,), n_test=2)


@pytest.fixture(scope="session")
def dataset(exact):
    return exact[0].dataset


@pytest.fixture
def run(exact, tmp_path):
    made = Run.create(tmp_path / "run", exact[0].dataset, "modal", {"seed": 0})
    made.save_space(exact[0].load_space(), {"seconds": 1.0})
    made.save_motion(exact[1], {"seconds": 2.0})
    return made


@pytest.fixture
def still_run(run, dataset, tmp_path):
    """The same without motion."""
    made = Run.create(tmp_path / "still", dataset, "modal", {"seed": 0})
    made.save_space(run.load_space(), {"seconds": 1.0})
    return made
