"""One camera: along its line of sight the motion is less certain than across, and the truth lies where it says."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import sparse
from scipy.sparse.linalg import spsolve

from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.gaussians import Gaussians
from tg4mm.motion import ModalMotion, MotionConfig
from tg4mm.motion.animate import displacement_at
from tg4mm.motion.certainty.posterior import n_solves, posterior
from tg4mm.motion.certainty.sight import directions
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.jacobian.view import view_jacobian
from tg4mm.motion.pictures.video import FixedCamera, fixed_cameras
from tg4mm.motion.posing.pose import Problems
from tg4mm.motion.prior.square_root import stiffness_root
from tg4mm.motion.solver.pcg import start, step
from tg4mm.motion.solver.problem import MotionProblem
from tg4mm.motion.train import train_motion
from tg4mm.runs import UNCERTAINTY, Run

SIGMA = 0.02
BALL = 252  # the last Gaussians


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, ModalMotion, FixedCamera, list[str]]:
    """A run of one camera, the true motion, the camera, and what it was warned of. The post sways across its line of
    sight, the ball moves mostly along it."""
    root = tmp_path_factory.mktemp("one")
    gaussians, motion = make_synthetic_dataset(
        root / "data", n_views=1, n_timesteps=5, size=48, freqs=(6.0,), amplitude=0.01, alphas=(), n_test=0
    )
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    capture = load_capture(run.dataset)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        train_motion(run, capture, load_images(capture), MotionConfig())
    return run, motion, fixed_cameras(capture)[0], [str(w.message) for w in caught]


def _errors(run: Run, true: ModalMotion, axis: np.ndarray) -> np.ndarray:
    """[N] rms over time of the error along `axis` [N, 3]."""
    found = run.load_motion()
    assert found is not None
    each = [displacement_at(found, t) - displacement_at(true, t) for t in range(true.n_timesteps)]
    along = np.einsum("tnc,nc->tn", np.stack(each), axis)
    return np.sqrt((along**2).mean(0))


def _seen(run: Run, camera: FixedCamera) -> np.ndarray:
    view = view_jacobian(run.load_space(), camera, (48, 48))
    seen = np.zeros(len(run.load_space()), bool)
    seen[view.bins.order[: view.bins.n_visible]] = True
    return seen


def _share_within_two(error: np.ndarray, deviation: np.ndarray) -> float:
    return float((error < 2 * deviation).mean())


def test_the_truth_of_a_scene_lies_within_two_deviations(trained) -> None:
    """Across, everywhere; along, of what is seen to move or stand still across."""
    run, true, camera, _ = trained
    part, _ = run.load_part(UNCERTAINTY)
    along, across = directions(camera, run.load_space().means.numpy())
    seen = _seen(run, camera)
    error, said = _errors(run, true, across)[seen], part["across_sight"].numpy()[seen]
    assert _share_within_two(error, said) > 0.85
    assert (error**2).mean() > 0.04 * (said**2).mean()  # no larger than they must be
    seen[-BALL:] = False  # the next test
    error, said = _errors(run, true, along)[seen], part["along_sight"].numpy()[seen]
    assert _share_within_two(error, said) > 0.85
    assert (error**2).mean() > 0.04 * (said**2).mean()


def test_of_what_moves_along_the_sight_alone_it_is_too_sure(trained) -> None:
    """Nothing in the pictures says how much that is. Known (docs/method.md); to be turned round once mended."""
    run, true, camera, _ = trained
    along, _ = directions(camera, run.load_space().means.numpy())
    said = run.load_part(UNCERTAINTY)[0]["along_sight"].numpy()
    assert _share_within_two(_errors(run, true, along)[-BALL:], said[-BALL:]) < 0.5


def test_a_motion_drawn_from_the_prior_lies_where_it_says(posed, trained) -> None:
    """Motion, noise and fit are then all as they are taken to be: 95 % within two deviations, of this draw.

    It is too sure of draws that are mostly a sway along the one camera's sight: docs/method.md, "Uncertainty".
    """
    (problem, gaussians), camera = posed, trained[2]
    means, rng = gaussians.means.numpy(), np.random.default_rng(5)
    root, n = stiffness_root(problem.graph), problem.graph.stiffness.shape[0]
    prior = (300.0 * (root.T @ root) + problem.config.ridge * sparse.identity(n)).tocsc()
    noise = np.sqrt(300.0) * (root.T @ rng.standard_normal((root.shape[0], 3)))
    noise += np.sqrt(problem.config.ridge) * rng.standard_normal((n, 3))
    field = spsolve(prior, noise).astype(np.float32)
    motion = problem.graph.motion(field)
    motion *= 0.005 / np.sqrt((motion[:, :3] ** 2).mean())
    shown = problem.views[0].jvp(motion[None])
    shown += 0.05 * np.sqrt((shown**2).mean()) * rng.standard_normal(shown.shape).astype(np.float32)
    found = posterior(problem, shown[None], 1)
    state = start(problem.right_hand_side(shown[None, 0]))
    for _ in range(100):
        state = step(state, problem.normal)
    error = (problem.field(state.x) - motion)[:, :3]
    for axis in directions(camera, means):
        said = np.sqrt(np.einsum("nc,ncd,nd->n", axis, found.covariance, axis))
        wrong = np.abs(np.einsum("nc,nc->n", axis, error))
        assert _share_within_two(wrong, said) > 0.85
        assert np.sqrt((wrong**2).mean() / (said**2).mean()) > 0.4


def test_along_the_line_of_sight_it_is_less_certain(trained) -> None:
    run, _, camera, _ = trained
    part, _ = run.load_part(UNCERTAINTY)
    seen = _seen(run, camera)
    along, across = (part[name].numpy()[seen] for name in ("along_sight", "across_sight"))
    assert np.sqrt((along**2).mean()) > 2 * np.sqrt((across**2).mean())


def test_its_parts_agree(trained) -> None:
    """The deviation is the root of the covariance's trace; along and across are its parts."""
    run = trained[0]
    part = {k: v.numpy().astype(np.float64) for k, v in run.load_part(UNCERTAINTY)[0].items()}
    assert part["covariance"].shape == (len(run.load_space()), 3, 3)
    np.testing.assert_allclose(part["covariance"], part["covariance"].transpose(0, 2, 1), rtol=1e-5)
    assert (np.linalg.eigvalsh(part["covariance"]) > -1e-9 * part["displacement"].max() ** 2).all()
    np.testing.assert_allclose(
        part["displacement"] ** 2, part["along_sight"] ** 2 + 2 * part["across_sight"] ** 2, rtol=1e-3
    )


def test_the_warning_and_the_log_say_how_much_is_a_guess(trained) -> None:
    run, _, _, said = trained
    (line,) = [text for text in said if "line of sight" in text]
    percent = run.log()["motion"]["guess_along_sight_percent"]
    assert 50 < percent <= 100
    assert f"so that {percent:.0f} % of the variance" in line
    assert "\n" not in line


@pytest.fixture(scope="module")
def posed(trained) -> tuple[MotionProblem, Gaussians]:
    run, _, camera, _ = trained
    gaussians = run.load_space()
    problems = Problems([view_jacobian(gaussians, camera, (48, 48))], gaussians, MotionConfig(), "cpu")
    (problem,) = problems.of(None, [300.0])
    assert isinstance(problem, MotionProblem)
    return problem, gaussians


def _pictures(problem: MotionProblem, sigma: float) -> np.ndarray:
    """[1, 1, 48, 48, 3] of a motion to and fro, with noise."""
    motion = np.zeros((1, problem.graph.n_gaussians, DOF), np.float32)
    motion[..., 1] = 0.01
    shown = problem.views[0].jvp(motion)
    return (shown + sigma * np.random.default_rng(1).normal(size=shown.shape)).astype(np.float32)[None]


def test_noise_of_the_pictures_makes_it_less_certain(posed) -> None:
    problem, _ = posed
    clean, noisy = (posterior(problem, _pictures(problem, s), 5) for s in (0.0, SIGMA))
    assert np.trace(noisy.noise, axis1=1, axis2=2).mean() > 5 * np.trace(clean.noise, axis1=1, axis2=2).mean()


def test_it_scales_with_the_motion_and_is_repeatable(posed) -> None:
    """Pictures twice as different, deviations twice as large; and the same draws each time."""
    problem, _ = posed
    pictures, counted = _pictures(problem, SIGMA), []
    one = posterior(problem, pictures, 5, update=counted.append)
    again = posterior(problem, pictures, 5)
    twice = posterior(problem, 2 * pictures, 5)
    np.testing.assert_array_equal(one.covariance, again.covariance)
    np.testing.assert_allclose(twice.deviation, 2 * one.deviation, rtol=0.02)
    assert counted[-1] == n_solves(1)


def test_what_it_counts_as_shown_is_no_more_than_there_is(posed) -> None:
    problem, _ = posed
    found = posterior(problem, _pictures(problem, SIGMA), 5)
    assert 3 < found.freedom < 48 * 48 * 3


def test_pictures_that_do_not_change_are_no_motion_and_no_doubt(posed) -> None:
    problem, _ = posed
    found = posterior(problem, 0 * _pictures(problem, 0.0), 5)
    assert not found.deviation.any()
    assert np.isfinite(torch.from_numpy(found.covariance)).all()


def test_of_large_motion_it_is_there_too(tmp_path: Path) -> None:
    """After rounds, in which the scene at rest stays as it was: one camera alone would bend it."""
    gaussians, _ = make_synthetic_dataset(
        tmp_path / "data", n_views=1, n_timesteps=5, size=32, freqs=(6.0,), amplitude=0.2, alphas=(), n_test=0
    )
    run = Run.create(tmp_path / "run", tmp_path / "data", "modal", {})
    run.save_space(gaussians, {})
    capture = load_capture(run.dataset)
    with pytest.warns(UserWarning, match="line of sight"):
        train_motion(run, capture, load_images(capture), MotionConfig(iterations=8, rounds=2))
    assert run.log()["motion"]["rounds"] >= 1
    assert torch.equal(run.load_space().means, gaussians.means)
    deviation = run.load_part(UNCERTAINTY)[0]["displacement"]
    assert torch.isfinite(deviation).all()
    assert deviation.max() > 0
