"""A run whose motion and whose uncertainty are known."""

import pytest
import torch

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.run import UNCERTAINTY, Run

AMPLITUDE, DEVIATION, NOISE = 0.02, 5e-4, 3e-4  # scene units


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """The post sways at 3 Hz, the ball goes to and fro at 7.5 Hz, both by 0.02 units of 0.1 m: 2 mm. 1 s at 30 Hz."""
    root = tmp_path_factory.mktemp("result")
    gaussians, motion = make_synthetic_dataset(
        root / "data", n_views=3, n_timesteps=30, size=32, freqs=(3.0, 7.5), amplitude=AMPLITUDE, alphas=(5,)
    )
    made = Run.create(root / "run", root / "data", "modal", {})
    made.save_space(gaussians, {})
    n = len(gaussians)
    parts = {"displacement": torch.full((n,), DEVIATION), "noise": torch.full((n,), NOISE)}
    made.save_part(UNCERTAINTY, parts)
    figures = {"reliability": [0.99, 0.9], "notes": ["the sun was low"], "noise_to_motion": 0.02}
    made.save_motion(motion, figures)
    return made
