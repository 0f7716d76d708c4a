"""Appearance through the whole stage: a shadow that goes with the motion is found, saved and magnified."""

import numpy as np
import pytest
import torch

from tests.helpers import synthetic
from tests.helpers.runs import copied
from tg4mm.capture import load_capture, load_images
from tg4mm.core.magnification import Magnification
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import MotionConfig
from tg4mm.run.poses import poses_of
from tg4mm.run.stages.motion import train_motion

HARMONIC = 0.28209479177387814
DARK = 0.015  # peak of the shadow's change, of 1: four levels of 8 bits


def shadow(means):
    """[N] how much darker each Gaussian gets at most: a soft patch on the floor."""
    away = ((means - torch.tensor([0.45, -0.6, 0.0])) ** 2).sum(1)
    return DARK * torch.exp(-4 * away) * (means[:, 2] < 0.01)


def true_sh(gaussians, t, alpha):
    """3 Hz in the post's phase."""
    sh = gaussians.sh.clone()
    now = (1 + alpha) * np.sin(2 * np.pi * 3 * t / 30)
    sh[:, 0] -= (now * shadow(gaussians.means) / HARMONIC)[:, None]
    return sh


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Eight cameras, ten timesteps, post and ball swaying at 3 Hz while a shadow comes and goes."""
    root = tmp_path_factory.mktemp("shaded")
    plain = synthetic._at

    def shaded(gaussians, motion, t, alpha):
        at = plain(gaussians, motion, t, alpha)
        return Gaussians(at.means, at.quats, at.scales, at.opacities, true_sh(gaussians, t, alpha))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "_at", shaded)
        run, _ = synthetic.exact_run(root, n_views=8, n_timesteps=10, size=48, amplitude=0.005)
    capture = load_capture(root / "data")
    return run, capture, load_images(capture)


@pytest.fixture(scope="module")
def trained(made, tmp_path_factory):
    run = copied(made[0], tmp_path_factory.mktemp("trained") / "run")
    train_motion(run, *made[1:], MotionConfig())
    return run


def changes(run, t, alpha):
    """[N, 3] change of colour, mean over all directions."""
    at = poses_of(run, Magnification(everywhere=alpha)).at(t)
    return ((at.sh - run.load_space().sh)[:, 0] * HARMONIC).numpy()


@pytest.mark.parametrize(("alpha", "bound"), [(0.0, 0.5), (4.0, 0.55)])
def test_the_shadow_is_found_and_magnified(trained, alpha, bound):
    """Error .40: motion of the checkered floor explains some of it, and smoothness takes some. Nothing found: 1."""
    gaussians = trained.load_space()
    where = (shadow(gaussians.means) > 0.3 * DARK).numpy()
    assert where.sum() > 8
    for t in (2, 3, 7):
        true = ((true_sh(gaussians, t, alpha) - gaussians.sh)[:, 0] * HARMONIC).numpy()
        off = (changes(trained, t, alpha) - true)[where]
        assert np.linalg.norm(off) < bound * np.linalg.norm(true[where])


def test_it_is_taken_away_with_its_motion(trained):
    most = np.abs(changes(trained, 2, 0.0)).max()
    assert most > 0.4 * DARK
    assert np.abs(changes(trained, 2, -1.0)).max() < 1e-3 * most


def test_the_log_tells_what_was_found(trained):
    gains = trained.log()["motion"]["appearance_reliability"]
    assert gains[0] > 0.7
    assert all(0 <= g <= 1 for g in gains)


def test_the_shadow_is_not_taken_for_motion(trained, made, tmp_path):
    """The floor under it stands still. The motion's second pass is fitted without what appearance explains."""
    run = copied(made[0], tmp_path / "run")
    plain = train_motion(run, *made[1:], MotionConfig(appearance=False))
    assert plain.appearance is None
    assert "appearance_reliability" not in run.log()["motion"]
    shaded = trained.load_motion()
    assert shaded is not None
    dark = (shadow(trained.load_space().means) > 0.3 * DARK).numpy()
    moves = [np.linalg.norm(m.displacement[:, dark]) for m in (shaded, plain)]
    assert moves[0] < 0.7 * moves[1]
