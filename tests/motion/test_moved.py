"""The problem of several poses: one pose is the plain problem, and with more the operator stays symmetric."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.gaussians import Gaussians
from tg4mm.motion import MotionConfig
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.jacobian.pixels import pixels_moved
from tg4mm.motion.jacobian.view import view_jacobian
from tg4mm.motion.pictures.video import FixedCamera, fixed_cameras
from tg4mm.motion.posing.pose import Problems
from tg4mm.motion.rounds.moved import MovedProblem, shown
from tg4mm.motion.rounds.polish import at_state
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.problem import MotionProblem

SIZE = (32, 32)


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory) -> tuple[MotionProblem, Gaussians, list[FixedCamera]]:
    root = tmp_path_factory.mktemp("moved")
    gaussians, _ = make_synthetic_dataset(
        root, n_views=2, n_timesteps=5, size=32, freqs=(6.0,), alphas=(), n_test=0
    )
    cameras = fixed_cameras(load_capture(root))
    views = [view_jacobian(gaussians, camera, SIZE) for camera in cameras]
    (problem,) = Problems(views, gaussians, MotionConfig(), "cpu").of(None, [300.0])
    assert isinstance(problem, MotionProblem)
    return problem, gaussians, cameras


def _two(posed) -> MovedProblem:
    """Two components, at rest and moved by a fifth of a unit, M a rotation apart."""
    problem, gaussians, cameras = posed
    shift = torch.zeros(len(gaussians), DOF)
    shift[:, 0] = 0.2
    views = [view_jacobian(at_state(gaussians, shift), camera, SIZE) for camera in cameras]
    c, s = np.cos(0.4), np.sin(0.4)
    a, b = np.array([c, s]), np.array([-s, c])
    return MovedProblem([problem, replace(problem, views=views)], np.stack([np.outer(a, a), np.outer(b, b)]))


def _theta(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, 3)).astype(np.float32)


def test_one_knot_at_rest_is_the_plain_problem(posed) -> None:
    problem = posed[0]
    moved, n = MovedProblem([problem], np.eye(2)[None]), problem.n_parameters
    a, b = _theta(n, 0), _theta(n, 1)
    expected = np.concatenate(problem.normals([a, b]))
    np.testing.assert_allclose(moved.normal(np.concatenate([a, b])), expected, rtol=1e-5)


def test_the_operator_is_symmetric_and_positive(posed) -> None:
    moved, n = _two(posed), 2 * posed[0].n_parameters
    a, b = _theta(n, 0), _theta(n, 1)
    ab, ba, aa = ((x.astype(np.float64) * moved.normal(y)).sum() for x, y in ((a, b), (b, a), (a, a)))
    assert ab == pytest.approx(ba, abs=1e-5 * aa)
    assert aa > 0


def test_components_are_coupled_where_poses_differ(posed) -> None:
    """Where they do not, the M add up to the identity and nothing couples."""
    moved, n = _two(posed), posed[0].n_parameters
    alone = np.concatenate([_theta(n, 0), np.zeros((n, 3), np.float32)])
    same = MovedProblem([moved.knots[0]] * 2, moved.mix)
    scale = np.linalg.norm(same.normal(alone)[:n])
    assert np.linalg.norm(same.normal(alone)[n:]) < 1e-5 * scale
    assert np.linalg.norm(moved.normal(alone)[n:]) > 1e-3 * scale


def test_a_device_does_the_same(posed) -> None:
    moved = _two(posed)
    there = MovedProblem([DeviceProblem(knot, "cpu") for knot in moved.knots], moved.mix)
    theta = _theta(2 * posed[0].n_parameters, 0)
    expected = moved.normal(theta)
    found = there.normal(torch.from_numpy(theta)).numpy()
    assert np.linalg.norm(found - expected) < 1e-3 * np.linalg.norm(expected)
    np.testing.assert_allclose(
        there.fields(torch.from_numpy(theta)), moved.fields(theta), rtol=1e-3, atol=1e-4
    )
    motions = moved.fields(theta)
    a, b = shown(moved.knots[0], motions), shown(there.knots[0], motions)
    assert np.linalg.norm(a - b) < 1e-3 * np.linalg.norm(a)


def test_a_small_part_that_moves_far_is_not_missed(posed) -> None:
    """Three of a hundred Gaussians in view."""
    problem, gaussians, cameras = posed
    view = problem.views[0]
    seen = view.bins.order[: view.bins.n_visible]
    shift = np.zeros((len(gaussians), 3))
    shift[seen[::33]] = 0.1 * cameras[0].viewmat[0, :3]
    assert pixels_moved([view], shift[None]) > 0.4


def test_pixels_are_those_of_a_shift_across(posed) -> None:
    """All move by the same along the picture's rows: focal length times shift over distance, 4 units in the middle."""
    problem, gaussians, cameras = posed
    shift = np.tile(0.1 * cameras[0].viewmat[0, :3], (len(gaussians), 1))
    focal = 16 / np.tan(0.6911112070083618 / 2)
    once, twice, never = pixels_moved(problem.views[:1], np.stack([shift, 2 * shift, 0 * shift]))
    assert focal * 0.1 / 4 < once < focal * 0.1 / 2.6  # 99 % are farther away than the nearest
    assert twice == pytest.approx(2 * once, rel=1e-5)
    assert never == 0


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["right", "down", "along the sight"])
def test_pixels_are_those_between_two_projections(posed, axis: int) -> None:
    """Each Gaussian by another length, along one axis of the camera."""
    problem, gaussians, cameras = posed
    view, camera = problem.views[0], cameras[0]
    lengths = np.random.default_rng(axis).uniform(0, 0.02, (len(gaussians), 1))
    shift = (lengths * camera.viewmat[axis, :3]).astype(np.float32)
    seen = view.bins.order[: view.bins.n_visible]
    means = gaussians.means.numpy().astype(np.float64)[seen]
    before, after = _projected(camera, means), _projected(camera, means + shift[seen])
    expected = np.percentile(np.linalg.norm(after - before, axis=1), 99)
    assert pixels_moved([view], shift[None]) == pytest.approx(expected, rel=0.01)


def _projected(camera: FixedCamera, points: np.ndarray) -> np.ndarray:
    """Pixels [n, 2]."""
    at = np.hstack([points, np.ones((len(points), 1))]) @ camera.viewmat[:3].T @ camera.K.T
    return at[:, :2] / at[:, 2:]
