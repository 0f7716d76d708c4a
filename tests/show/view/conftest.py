"""A run of an exact model, as the view opens it: a post sways at 2.5 Hz, a ball moves at 5 Hz, a floor stands still."""

import pytest
import torch

from tests.helpers.synthetic import moving_run
from tg4mm.run import UNCERTAINTY, Run
from tg4mm.show.view.scene import open_scene

DEVIATION = 2e-4  # scene units


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    root = tmp_path_factory.mktemp("view")
    made = moving_run(root, n_views=4, n_timesteps=12, size=48, freqs=(2.5, 5.0), amplitude=0.01)
    made.save_part(UNCERTAINTY, {"displacement": torch.full((len(made.load_space()),), DEVIATION)})
    return made


@pytest.fixture(scope="session")
def still_run(run, tmp_path_factory):
    """The same without motion, its dataset gone."""
    made = Run.create(tmp_path_factory.mktemp("still") / "run", run.path.parent / "gone", "modal", {})
    made.save_space(run.load_space(), {})
    return made


@pytest.fixture(scope="session")
def scene(run):
    return open_scene(run)
