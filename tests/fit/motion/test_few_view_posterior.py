"""One camera: along its line of sight the motion is less certain than across, and the truth lies where it says."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu

from tests.helpers.synthetic import exact_run
from tg4mm.capture import load_capture, load_images
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion.animate import displacement_at
from tg4mm.fit.motion.few_view_posterior import unseen_motion
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.pixels import along_and_across
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.observations import fixed_cameras
from tg4mm.fit.motion.prior.graph import stiffness_root
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.run import UNCERTAINTY
from tg4mm.run.stages.motion import train_motion

BALL = 252  # the last Gaussians


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of one camera, the true motion, and the camera. The post sways across its line of sight, the ball moves
    mostly along it.
    """
    root = tmp_path_factory.mktemp("one")
    run, motion = exact_run(root, n_views=1, n_timesteps=5, size=48, freqs=(6.0,), amplitude=0.01)
    capture = load_capture(run.dataset)
    train_motion(run, capture, load_images(capture), MotionConfig())
    return run, motion, fixed_cameras(capture)[0]


def _errors(run, true, axis):
    """[N] rms over time of the error along `axis` [N, 3]."""
    found = run.load_motion()
    assert found is not None
    each = [displacement_at(found, t) - displacement_at(true, t) for t in range(true.n_timesteps)]
    along = np.einsum("tnc,nc->tn", np.stack(each), axis)
    return np.sqrt((along**2).mean(0))


def _seen(run, camera):
    view = view_jacobian(run.load_space(), camera, (48, 48))
    seen = np.zeros(len(run.load_space()), bool)
    seen[view.bins.order[: view.bins.n_visible]] = True
    return seen


def _share_within_two(error, deviation):
    return float((error < 2 * deviation).mean())


def test_the_truth_of_a_scene_lies_within_two_deviations(trained):
    """Across, everywhere; along, of what is seen to move or stand still across."""
    run, true, camera = trained
    part, _ = run.load_part(UNCERTAINTY)
    along, across = along_and_across(camera, run.load_space().means.numpy())
    seen = _seen(run, camera)
    error, said = _errors(run, true, across)[seen], part["across_sight"].numpy()[seen]
    assert _share_within_two(error, said) > 0.85
    assert (error**2).mean() > 0.04 * (said**2).mean()  # no larger than they must be
    seen[-BALL:] = False  # the next test
    error, said = _errors(run, true, along)[seen], part["along_sight"].numpy()[seen]
    assert _share_within_two(error, said) > 0.85


def test_motion_towards_the_camera_may_be_as_large_as_directions_in_space_allow(trained):
    """95 % of random directions have less than 2 × 1.5 times as much along the sight as across."""
    run, _, camera = trained
    part, found = run.load_part(UNCERTAINTY)[0], run.load_motion()
    along = along_and_across(camera, run.load_space().means.numpy())[0]
    moves = [displacement_at(found, t) for t in range(found.n_timesteps)]
    across2 = np.mean([(d**2).sum(1) - np.einsum("nc,nc->n", d, along) ** 2 for d in moves], 0)
    moving = across2 > 0.5 * across2.max()
    said = part["along_sight"].numpy()[moving]
    assert (said > 1.2 * np.sqrt(across2[moving])).mean() > 0.9
    directions = np.random.default_rng(0).normal(size=(10_000, 3))
    ratio = np.abs(directions[:, 2]) / np.linalg.norm(directions[:, :2], axis=1)
    assert 0.94 < (ratio < 2 * 1.5).mean() < 0.96


def test_motions_drawn_from_the_prior_lie_where_it_says(posed, trained):
    """Motion and fit are then all as they are taken to be, but for noise, of which the covariance has none: 95 %
    within two deviations. Along the sight a draw has a few large coordinates alone, so there are several.
    """
    means, rng, draws = trained[0].load_space().means.numpy(), np.random.default_rng(5), 16
    root, n = stiffness_root(posed.graph), posed.graph.stiffness.shape[0]
    prior = splu((posed.smoothness_weight * (root.T @ root) + posed.ridge * sparse.identity(n)).tocsc())
    noise = np.sqrt(posed.smoothness_weight) * (root.T @ rng.standard_normal((root.shape[0], 3 * draws)))
    noise += np.sqrt(posed.ridge) * rng.standard_normal((n, 3 * draws))
    fields = prior.solve(noise).reshape(n, draws, 3).transpose(1, 0, 2).astype(np.float32)
    motions = np.stack([posed.graph.motion(field) for field in fields])
    motions *= 0.005 / np.sqrt((motions[..., :3] ** 2).mean())
    shown = [view.jvp(motions) for view in posed.views]
    theta = pcg(posed, posed.right_hand_sides(shown), 100, 1e-4).theta
    x = posed.gradient_fields(theta)
    covariance = np.mean([unseen_motion(posed, x, draws, seed).covariance for seed in range(3)], axis=0)
    errors = (posed.fields(theta) - motions)[..., :3]
    for axis in along_and_across(trained[2], means):
        said = np.sqrt(np.einsum("nc,ncd,nd->n", axis, covariance, axis))
        wrong = np.abs(np.einsum("nc,rnc->rn", axis, errors))
        # 1.2 of 24 motions by 64 draws; 16 by 24 of few coordinates scatter by a quarter. Solved to 3e-3 it was 9
        assert 0.6 < np.sqrt((wrong**2).mean() / (said**2).mean()) < 2.2
        assert _share_within_two(wrong, said) > 0.6


@pytest.fixture(scope="module")
def posed(trained):
    run, _, camera = trained
    gaussians = run.load_space()
    problem = Problem.of([view_jacobian(gaussians, camera, (48, 48))], gaussians, MotionConfig(), "cpu")
    return problem.on_cpu(problem.everything, 300.0)


def _fitted(operator, size=0.01):
    """x [1, 4N, 3] of a motion to and fro."""
    motion = np.zeros((1, operator.graph.n_gaussians, DOF), np.float32)
    motion[..., 1] = size
    shown = [view.jvp(motion) for view in operator.views]
    return operator.gradient_fields(pcg(operator, operator.right_hand_sides(shown), 30, 1e-6).theta)


def test_what_it_counts_as_shown_is_what_the_pictures_determine(posed):
    """The trace of A⁻¹ JᵀJ, here by twenty other random pictures."""
    rng, found = np.random.default_rng(9), []
    for _ in range(20):
        white = [rng.standard_normal((1, 48, 48, 3), dtype=np.float32) for _ in posed.views]
        b = posed.right_hand_sides(white)
        found.append(float((b.astype(float) * pcg(posed, b, 100, 3e-3).theta).sum()))
    said = unseen_motion(posed, _fitted(posed), 5).freedom
    assert 3 < said < 48 * 48 * 3
    assert said == pytest.approx(np.mean(found), rel=4 * np.std(found) / np.mean(found) / np.sqrt(2))
