"""The linear fit's two passes: together one solution, of the pictures less what is taken away between them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fit.motion.scenes import N, problem
from tg4mm.fit.motion import linear_fit as module
from tg4mm.fit.motion.checkpoints import no_checkpoint
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import CANDIDATES, Hyperparameters
from tg4mm.fit.motion.linear_fit import LinearFit
from tg4mm.fit.motion.prior import edge_residual, reweight_edges
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.targets import TargetImages

FOLDS = [Fold(np.array([0])), Fold(np.array([1]))]
LONG = MotionConfig(iterations=600, tolerance=1e-6, ridge=0.1)
LOOSE, STIFF = CANDIDATES[0], CANDIDATES[1]  # edges are reweighted above the least candidate alone


def pictures(seed):
    """Three components of two cameras, [V, R, H, W, 3]; the second is noise."""
    return np.random.default_rng(seed).normal(size=(2, 3, *problem().size[::-1], 3)).astype(np.float32)


def fit(images, config=LONG, weight=LOOSE, mixing=None):
    left = np.zeros((2, *problem().size[::-1]), np.float32)
    targets = TargetImages(np.eye(3, 10), np.ones(10), images, left, 3, images[:, 0])
    whole = replace(problem(config.ridge), mixing=mixing)
    hyper = Hyperparameters(np.array([False, mixing is None, False]), weight)
    return LinearFit(whole, targets, hyper, FOLDS, config, no_checkpoint)


def both_passes(fitting, taken=None):
    """[P, R, N, 6]."""
    images = np.zeros_like(fitting.targets.images) if taken is None else taken

    def correction(p, fields, some):
        return [images[v, fitting.hyper.signal[some]] for v in FOLDS[p].views]

    return fitting.second_pass(fitting.first_pass(), True, correction)


def solved(operator, images):
    return operator.fields(pcg(operator, operator.right_hand_sides(images), 2000, 1e-6).theta)


def direct(fitting, images):
    of_folds = ((fitting.operator(f), [images[v][[0, 2]] for v in f.views]) for f in FOLDS)
    return np.stack([solved(operator, own) for operator, own in of_folds])


@pytest.mark.parametrize("together", [1, 8])
@pytest.mark.parametrize("takes", [False, True])
def test_they_end_where_one_fit_of_what_is_left_would(takes, together, monkeypatch):
    monkeypatch.setattr(module, "TOGETHER", together)
    images, taken = pictures(1), 0.3 * pictures(2)
    found = both_passes(fit(images), taken if takes else None)
    expected = direct(fit(images), images - taken if takes else images)
    assert found.shape == (2, 2, N, 6)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())
    if takes:
        assert np.abs(direct(fit(images), images) - expected).max() > 0.05 * np.abs(expected).max()


def test_mixed_targets_are_fitted_as_one_system():
    """Two target images of three fields, none of which is noise by itself."""
    rng = np.random.default_rng(5)
    mixing = [rng.normal(size=(2, 3)).astype(np.float32) for _ in range(2)]
    images = pictures(1)[:, :2]
    fitting = fit(images, mixing=mixing)
    found = fitting.second_pass(fitting.first_pass(), False)
    assert found.shape == (2, 3, N, 6)
    for p, fold in enumerate(FOLDS):
        expected = solved(fitting.operator(fold), [images[v] for v in fold.views])
        np.testing.assert_allclose(found[p], expected, atol=5e-3 * np.abs(expected).max())


def test_the_second_pass_solves_with_the_edges_reweighted():
    """What both passes find is the solution of the reweighted problem, and another than without."""
    images = pictures(1)
    fitting = fit(images, weight=STIFF)
    first = fitting.first_pass()
    residual = edge_residual(fitting.problem.graph, first[0]["x"], first[1]["x"])
    assert (residual > 0).mean() > 0.3
    graph = reweight_edges(fitting.problem.graph, residual)
    expected = np.stack(
        [solved(fitting.operator(f).with_graph(graph), [images[v][[0, 2]] for v in f.views]) for f in FOLDS]
    )
    largest = np.abs(expected).max()
    np.testing.assert_allclose(both_passes(fitting), expected, atol=3e-3 * largest)
    assert np.abs(direct(fitting, images) - expected).max() > 0.02 * largest


def test_a_second_fit_within_a_support_moves_nothing_else():
    rng = np.random.default_rng(5)
    mixing = [rng.normal(size=(2, 3)).astype(np.float32) for _ in range(2)]
    asked: list[str] = []
    fitting = replace(
        fit(pictures(1)[:, :2], MotionConfig(iterations=4), mixing=mixing),
        checkpoint=lambda name, compute: asked.append(name) or compute(),
    )
    support = (rng.random((3, N)) < 0.5).astype(np.float32)
    for found in fitting.within(support, 1):
        assert (found["fields"][support == 0] == 0).all()
        assert (np.abs(found["fields"][support == 1]).sum(-1) > 0).all()
    assert asked == ["first_pass_0_support_1", "first_pass_1_support_1"]
