"""The difference loss of phase 2: what the frozen model gets wrong at timestep 0 drops out of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.research.paper.conftest import SETTINGS
from tg4mm.capture import load_capture, load_images
from tg4mm.core.errors import CaptureError
from tg4mm.research.paper.config import PaperConfig
from tg4mm.research.paper.model import load_model
from tg4mm.research.paper.motion import at_rest
from tg4mm.research.paper.space import cameras_on, first_views, view_loss
from tg4mm.run import Run
from tg4mm.run.train import train


@pytest.fixture(scope="module")
def views(data: Path):
    capture = load_capture(data)
    return first_views(capture, load_images(capture))


def test_static_errors_cost_nothing(trained: Run, views) -> None:
    model = load_model(trained)
    first = at_rest(model, views)
    # A picture with the model's error, an unmodelled gradient on top, and nothing that moved.
    wrong = replace(
        views, rgb=views.rgb * np.linspace(0.5, 1.0, views.rgb.shape[2], dtype=np.float32)[:, None]
    )
    compared = replace(wrong, rgb=wrong.rgb + at_rest(model, wrong).missing)
    for v in range(len(views.rgb)):
        assert float(view_loss(model.rest(), cameras_on(wrong, "cpu"), v)) > 0.02
        assert float(view_loss(model.rest(), cameras_on(compared, "cpu"), v)) < 1e-6
    assert np.abs(first.missing).mean() > 1e-3  # the model is not perfect, so there is something to take out


def test_a_camera_that_moved_is_refused(trained: Run, views) -> None:
    first = at_rest(load_model(trained), views)
    moved = views.viewmats.copy()
    moved[1, 0, 3] += 0.1
    with pytest.raises(CaptureError, match="a camera moved"):
        first.row_of(replace(views, viewmats=moved), 1)


def test_the_setting_trains_another_motion_of_the_same_scene(
    trained: Run, data: Path, tmp_path: Path
) -> None:
    settings = {**SETTINGS, "paper.motion_iterations": "20"}
    runs = {
        on: train(data, tmp_path / on, "paper-tuned", settings={**settings, "paper.difference": on})
        for on in ("true", "false")
    }
    spaces = [load_model(run).planes.numpy() for run in runs.values()]
    np.testing.assert_array_equal(*spaces)
    motions = [run.load_motion().displacement for run in runs.values()]
    assert np.abs(motions[0] - motions[1]).max() > 1e-6
    assert PaperConfig().difference is False
