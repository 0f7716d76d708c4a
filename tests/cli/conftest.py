"""One moving run for the commands that read it."""

import pytest

from tests.helpers.synthetic import moving_run


@pytest.fixture(scope="session")
def run_path(tmp_path_factory):
    """Its model is the one its dataset was rendered from: 5 Hz at 15 Hz, 6 timesteps, two test cameras."""
    scene = {"n_views": 3, "n_timesteps": 6, "size": 32, "freqs": (5.0,), "fps": 15.0}
    return moving_run(tmp_path_factory.mktemp("cli"), **scene, alphas=(5, 20), n_test=2).path
