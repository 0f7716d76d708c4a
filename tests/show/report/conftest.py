"""A small dataset with ground truth, a run of its exact model, and the scores of that run."""

import pytest
import torch

from tests.helpers.runs import made_run
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.research.evaluate.run import evaluate_run
from tg4mm.run import UNCERTAINTY, Run


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    root = tmp_path_factory.mktemp("report")
    scene = {"n_views": 4, "n_timesteps": 12, "size": 48, "freqs": (2.5, 5.0), "fps": 15.0, "amplitude": 0.01}
    model = make_synthetic_dataset(root / "sway", **scene, alphas=(5, 20))
    made = Run.create(root / "run", root / "sway", "modal", {"seed": 0})
    made.save_space(model[0], {"seconds": 61.0, "peak_memory_mib": 512.0, "psnr_db": 31.5})
    made.save_part(UNCERTAINTY, {"displacement": torch.full((len(model[0]),), 2e-4)})
    made.save_motion(model[1], {"seconds": 30.0})
    return made


@pytest.fixture(scope="session")
def metrics(run):
    return evaluate_run(run)


@pytest.fixture
def bare_run(tmp_path):
    """A run on the least a dataset can be: training images, fps, nothing else."""
    scene = {"n_views": 3, "n_timesteps": 6, "size": 32, "freqs": (5.0,), "n_test": 0}
    model = make_synthetic_dataset(tmp_path / "bare", **scene)
    (tmp_path / "bare" / "scene.json").write_text('{"fps": 30}')
    (tmp_path / "bare" / "truth" / "motion.npz").unlink()
    return made_run(tmp_path / "run", tmp_path / "bare", *model)
