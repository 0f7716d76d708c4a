"""What least squares leaves out where the Jacobian is wrong is found by the other half's pictures."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tests.fit.motion.scenes import camera_of, gaussians_of, view_of
from tests.fit.rasterize.oracle import make_scene
from tg4mm.fit.motion.amplitude_bias import Gain, gain_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem

N, CAMERAS = 150, 8


@dataclass(frozen=True)
class Flat:
    is_flat: bool = False


@dataclass(frozen=True)
class Model:
    """As much of a `TemporalModel` as the gain asks for."""

    problem: Problem
    folds: list[Fold]
    pictures: list[np.ndarray]
    observations: Flat = Flat()
    config: MotionConfig = field(default_factory=MotionConfig)
    separates: bool = True

    def images(self, v):
        return self.pictures[v]


@pytest.fixture(scope="module")
def seen():
    """Eight cameras look at a cloud, of which the left half moves."""
    scene = make_scene(1, n=N, cameras=CAMERAS)
    true = gaussians_of(scene)
    left = np.argsort(true.means[:, 0].numpy())[:75]
    field = np.zeros((1, N, DOF), np.float32)
    field[:, left, 0] = 0.02
    views = [view_of(scene, c) for c in range(CAMERAS)]
    return views, true, field, left


def model_of(views, gaussians, pictures):
    folds = [Fold(np.arange(CAMERAS)[::2]), Fold(np.arange(CAMERAS)[1::2])]
    return Model(Problem.of(views, gaussians, MotionConfig(), "cpu"), folds, pictures)


def changes(views, field, noise, seed):
    rng = np.random.default_rng(seed)
    clean = [view.jvp(field).copy() for view in views]
    size = noise * np.sqrt(np.mean([np.mean(p**2) for p in clean]))
    return [(p + size * rng.normal(size=p.shape)).astype(np.float32) for p in clean]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("share", [0.5, 0.8, 1.0])
def test_what_is_left_out_is_found_in_noise(seen, share, seed):
    """Fields of both halves that are a share of the true one, each with errors of its own."""
    views, gaussians, field, _ = seen
    rng = np.random.default_rng(seed)
    folds = share * np.stack([field, field]) + 0.001 * rng.normal(size=(2, *field.shape)).astype(np.float32)
    found = gain_of(model_of(views, gaussians, changes(views, field, 0.3, seed)), folds.astype(np.float32))
    assert found.ratio == pytest.approx(1 / share, rel=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_least_squares_with_gaussians_at_wrong_places_is_corrected(seen, seed):
    """The one number that scales the true field comes out too small; most of what lacks is made up."""
    views, gaussians, field, _ = seen
    pictures = changes(views, field, 0.3, seed)
    rng = np.random.default_rng(seed)
    off = gaussians.means + 0.05 * rng.normal(size=(N, 3)).astype(np.float32)
    wrong = replace(gaussians, means=off)
    jacobians = [
        view_jacobian(
            wrong, camera_of(make_scene(1, n=N, cameras=CAMERAS), c), views[0].transmittance.shape[::-1]
        )
        for c in range(CAMERAS)
    ]
    model = model_of(jacobians, wrong, pictures)
    shares = []
    for fold in model.folds:
        shown = np.stack([jacobians[v].jvp(field) for v in fold.views])
        shares.append(np.vdot(shown, np.stack([pictures[v] for v in fold.views])) / np.vdot(shown, shown))
    share = np.mean(shares)
    assert share < 0.9
    found = gain_of(model, np.stack([s * field for s in shares]).astype(np.float32))
    assert abs(share * found.ratio - 1) < 0.5 * abs(share - 1)


def test_it_is_larger_where_things_move(seen):
    views, gaussians, field, left = seen
    folds = 0.5 * np.stack([field, field])
    found = gain_of(model_of(views, gaussians, changes(views, field, 0.5, 0)), folds)
    rest = np.setdiff1d(np.arange(N), left)
    assert 1 <= found.places.min() <= found.places.max() <= found.ratio
    assert found.places[left].mean() > found.places[rest].mean()


def test_it_is_never_below_one_and_unknown_for_few_cameras_and_one_fold(seen):
    views, gaussians, field, _ = seen
    model = model_of(views, gaussians, changes(views, field, 0.5, 0))
    assert gain_of(model, 2 * np.stack([field, field])).ratio == 1
    assert gain_of(model, field[None]).ratio == 1
    few = replace(model, problem=Problem.of(views[:4], gaussians, MotionConfig(), "cpu"))
    assert gain_of(few, np.stack([field, field])).ratio == 1
    off = replace(model, config=MotionConfig(attenuation=False))
    assert gain_of(off, 0.5 * np.stack([field, field])).ratio == 1


def test_a_correction_may_be_wrong_by_itself():
    field = np.ones((1, 3, DOF), np.float32)
    np.testing.assert_allclose(Gain(1.4, 0.1).squares(field), 3 * (0.4**2 + 0.1**2), rtol=1e-6)
    assert not Gain().squares(field).any()
