"""A small run with everything a page can show, and a browser to show it in."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.helpers.synthetic import make_synthetic_dataset, with_phasors
from tests.show.view.browser import browser as chromium
from tg4mm.fit.motion.modes import AppearanceModes
from tg4mm.run import Run
from tg4mm.show.web.write import export_html


@pytest.fixture(scope="session")
def moving_run(tmp_path_factory):
    """Post and ball sway and turn at 3 and 6 Hz; oblong Gaussians, colours of degree 3, light that changes."""
    root = tmp_path_factory.mktemp("web")
    gaussians, motion = make_synthetic_dataset(
        root / "data", n_views=2, n_timesteps=20, size=96, freqs=(3.0, 6.0), n_test=0
    )
    n, rng = len(gaussians), np.random.default_rng(0)
    sh = rng.normal(0, 0.06, (n, 16, 3)).astype(np.float32)
    sh[:, :1] = gaussians.sh.numpy()
    gaussians = replace(
        gaussians,
        quats=torch.as_tensor(rng.normal(size=(n, 4)), dtype=torch.float32),
        scales=gaussians.scales * torch.as_tensor(rng.uniform(0.5, 1.6, (n, 3)), dtype=torch.float32),
        opacities=torch.as_tensor(rng.uniform(0.3, 1, n), dtype=torch.float32),
        sh=torch.as_tensor(sh),
    )
    moves = np.abs(motion.displacement).any(axis=2, keepdims=True)
    light = AppearanceModes(
        rng.normal(0, 0.02, (2, n, 4, 3)).astype(np.float32), np.array([[1, 0.5j], [0.2, 1]], np.complex128)
    )
    turns = moves * np.array([[[0.004j, 0.01, 0.0]], [[0.0, 0.003, 0.012j]]])
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    run.save_motion(replace(with_phasors(motion, rotation=turns.astype(np.complex64)), appearance=light), {})
    return run


@pytest.fixture(scope="session")
def still_run(moving_run, tmp_path_factory):
    """The same scene in a run without motion."""
    run = Run.create(tmp_path_factory.mktemp("still") / "run", moving_run.dataset, "modal", {})
    run.save_space(moving_run.load_space(), {})
    return run


@pytest.fixture(scope="session")
def page_file(moving_run, tmp_path_factory):
    """The page of `moving_run`."""
    return export_html(moving_run, tmp_path_factory.mktemp("page") / "scene.html")


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened
