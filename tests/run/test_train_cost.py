"""What a training costs is told stage by stage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.research.paper import preset as paper
from tg4mm.run import preset as modal
from tg4mm.run.train import train

SMALL = {"space.max_gaussians": "400", "space.init_points": "300"}
MODAL = {**SMALL, "space.iterations": "60", "motion.iterations": "4", "motion.components": "2"}
PAPER = {
    **SMALL, "paper.warm_up": "40", "paper.iterations": "80", "paper.motion_iterations": "4", "paper.channels": "2",
    "paper.resolution": "16",
}  # fmt: skip
MIB = 1 << 20
PASSING = 400  # MiB held for a moment before a stage


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cost") / "sway_5Hz_0_02"
    make_synthetic_dataset(path, n_views=5, n_timesteps=6, size=32, freqs=(5.0,), alphas=(), n_test=0)
    return path


@pytest.mark.parametrize(
    ("preset", "step", "stage"),
    [
        ("modal", "train_space", "space"),
        ("modal", "train_motion", "motion"),
        ("paper-tuned", "train_triplane", "triplane"),
        ("paper-tuned", "train_timesteps", "motion"),
    ],
)
def test_a_stage_has_a_peak_of_its_own(
    preset: str, step: str, stage: str, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not reset_peak_memory():
        pytest.skip("the system cannot start a peak anew")
    fits = paper if preset == "paper-tuned" else modal
    before, real = [], getattr(fits, step)

    def after_a_peak(*arguments: Any) -> Any:
        held = np.ones(PASSING * MIB, np.uint8)
        before.append(peak_memory_mib())
        del held
        return real(*arguments)

    monkeypatch.setattr(fits, step, after_a_peak)
    run = train(data, tmp_path / "run", preset, settings=MODAL if preset == "modal" else PAPER)
    assert run.log()[stage]["peak_memory_mib"] < before[0] - PASSING / 2
