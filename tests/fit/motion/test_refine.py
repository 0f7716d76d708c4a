"""The scene at rest, refined with the motion known: from whose cameras, how states count, and when it stays."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.fit.motion import MotionConfig, gauss_newton
from tg4mm.fit.motion.refine import refine_rest_scene
from tg4mm.run import Run
from tg4mm.run.stages.motion import train_motion

SHORT = MotionConfig(components=1, smoothness_weight=300.0, iterations=6, gauss_newton=1, tolerance=1e-6)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Seven cameras; the Gaussians are where they should be, but blurred."""
    root = tmp_path_factory.mktemp("seven") / "data"
    gaussians, _ = make_synthetic_dataset(
        root, n_views=7, n_timesteps=5, size=32, freqs=(6.0,), amplitude=0.2, alphas=(), n_test=0
    )
    return root, replace(gaussians, scales=1.5 * gaussians.scales)


def _trained(data, path, config=SHORT, wandering=None):
    """`wandering`: a camera that stays nowhere."""
    capture = load_capture(data[0])
    run = Run.create(path, data[0], "modal", {})
    run.save_space(data[1], {})
    train_motion(
        run, capture if wandering is None else _without(capture, wandering), load_images(capture), config
    )
    return run


def _without(capture, camera):
    ids = capture.camera_ids.copy()
    rows = np.flatnonzero(ids == camera)
    ids[rows] = ids.max() + np.arange(len(rows))
    return replace(capture, camera_ids=ids)


def _is_as_before(run, gaussians):
    found = run.load_space()
    names = ("means", "quats", "scales", "opacities", "sh")
    return all(torch.equal(getattr(found, n), getattr(gaussians, n)) for n in names)


def test_fixed_cameras_alone_sharpen_the_scene(data, tmp_path):
    assert not _is_as_before(_trained(data, tmp_path / "run"), data[1])


def test_a_scene_that_other_cameras_saw_stays(data, tmp_path):
    """Six fixed cameras and one that wanders: the motion is found, the scene is not theirs alone."""
    run = _trained(data, tmp_path / "run", wandering=6)
    log = run.log()["motion"]
    assert (log["views"], log["gauss_newton"]) == (6, 1)
    assert _is_as_before(run, data[1])


@pytest.mark.parametrize("brightened", [0.0, 0.5])
def test_gaussians_that_show_the_pictures_worse_are_not_taken(brightened, data, tmp_path, monkeypatch):
    """What changes is off; or sharper as it ought to be, but all of it too bright at all times."""
    real = refine_rest_scene

    def worse(*args):
        g = real(*args)
        return replace(g, means=g.means + (0.0 if brightened else 0.2), sh=g.sh + brightened)

    monkeypatch.setattr(gauss_newton, "refine_rest_scene", worse)
    run = _trained(data, tmp_path / "run")
    assert run.log()["motion"]["gauss_newton"] == 1
    assert np.diff(run.log()["motion"]["misfits"])[0] < 0
    assert _is_as_before(run, data[1])
