"""A problem in smaller pictures tells as much of the motion, but for texture finer than its pixels."""

import numpy as np
import pytest

from tests.fit.motion.filmed import K_of
from tests.helpers.synthetic import _gaussians, _parts, _viewmats
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.few_view_posterior import coarser, unseen_motion
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.nuisance.projection import nuisances_of
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem

SIZE, HALF = 96, 48 * 48


@pytest.fixture(scope="module")
def fine() -> tuple[Problem, list[PosedFrames]]:
    gaussians = _gaussians(_parts(1), 1)
    viewmat = _viewmats(1, 0.0)[0].astype(np.float32)
    frames = [PosedFrames("0", viewmat, K_of(SIZE), np.arange(2), np.arange(2) / 30)]
    views = [view_jacobian(gaussians, f, (SIZE, SIZE)) for f in frames]
    nuisances = nuisances_of(views, frames, gaussians.means.numpy(), np.arange(12) < 6)
    shown = np.stack([v.over_white for v in views])
    weights = np.random.default_rng(0).uniform(0.5, 1.5, (1, SIZE, SIZE)).astype(np.float32)
    problem = Problem.of(views, gaussians, MotionConfig(), "cpu")
    return problem.changed(nuisances=nuisances, means=shown, pixel_weights=weights), frames


def weights_of(problem: Problem) -> np.ndarray:
    assert problem.pixel_weights is not None
    return problem.pixel_weights


def test_a_quarter_of_the_pixels_tell_as_much(fine: tuple) -> None:
    problem, small = fine[0], coarser(*fine, enough=HALF)
    assert small.size == (48, 48)
    assert weights_of(small).sum() == pytest.approx(weights_of(problem).sum(), rel=1e-3)
    motion = np.zeros((1, problem.n_gaussians, 6), np.float32)
    motion[..., :3] = [1, 0.5, 0.2]
    energies = [
        float((weights_of(p)[0, ..., None] * p.views[0].jvp(motion)[0] ** 2).sum()) for p in (problem, small)
    ]
    assert 0.6 * energies[0] < energies[1] < energies[0]


def test_what_is_unknown_is_nearly_the_same_and_not_less(fine: tuple) -> None:
    deviations = []
    for p in (fine[0], coarser(*fine, enough=HALF)):
        operator = p.on_cpu(Fold(np.arange(1)), 30.0)
        x = np.random.default_rng(1).normal(size=(1, 4 * p.n_gaussians, 3)).astype(np.float32)
        unseen = unseen_motion(operator, x, 10)
        deviations.append(np.sqrt(np.trace(unseen.covariance, axis1=1, axis2=2) / unseen.prior_scale**2))
    ratio = deviations[1] / deviations[0]
    assert 0.97 < np.median(ratio) < 1.3
