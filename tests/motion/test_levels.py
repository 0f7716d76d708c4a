"""Two levels of unknowns: the diagonal is the operator's, the minimum the same, and reached in far fewer steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.sparse import csr_matrix

from tests.motion.test_problem import problem
from tg4mm.motion import levels as module
from tg4mm.motion.device import DeviceProblem
from tg4mm.motion.graph import ROWS
from tg4mm.motion.levels import Levels, information
from tg4mm.motion.linear import DOF
from tg4mm.motion.problem import MotionProblem
from tg4mm.motion.solve import CGState, start, step


def plain(p: MotionProblem) -> MotionProblem:
    """The same problem with the field itself as unknowns: no scaling, and groups that hold nothing."""
    n = p.graph.n_gaussians
    blocks = np.tile(np.eye(ROWS, dtype=np.float32), (n, 1, 1))
    nothing = csr_matrix((ROWS * n, ROWS), dtype=np.float32)
    return replace(p, levels=Levels(blocks, nothing, np.eye(ROWS, dtype=np.float32)))


def pictures(p: MotionProblem) -> np.ndarray:
    height, width = p.views[0].transmittance.shape
    return np.random.default_rng(3).normal(size=(len(p.views), height, width, 3)).astype(np.float32)


def solved(p: MotionProblem, steps: int) -> CGState:
    state = start(p.right_hand_side(pictures(p)))
    for _ in range(steps):
        state = step(state, p.normal)
    return state


def test_the_information_is_the_diagonal_of_the_data() -> None:
    """Against single motions of every Gaussian; mean over x, y, z."""
    p = problem()
    n = p.graph.n_gaussians
    exact = np.zeros((n, DOF))
    for i in range(n):
        for k in range(DOF):
            motion = np.zeros((n, DOF), np.float32)
            motion[i, k] = 1
            exact[i, k] = sum(float((view.push(motion).astype(np.float64) ** 2).sum()) for view in p.views)
    found = information(p.views, n, np.random.default_rng(0), probes=400)
    np.testing.assert_allclose(found, exact.reshape(n, 2, 3).mean(2), rtol=0.3, atol=1e-6 * exact.max())
    assert found[:, 0].mean() == pytest.approx(exact[:, :3].mean(), rel=0.03)


def test_from_field_is_the_transpose() -> None:
    p, rng = problem(), np.random.default_rng(1)
    theta = rng.normal(size=(p.n_parameters, 3)).astype(np.float32)
    v = rng.normal(size=(ROWS * p.graph.n_gaussians, 3)).astype(np.float32)
    one = (p.levels.field(theta).astype(float) * v).sum()
    other = (p.levels.from_field(v).astype(float) * theta).sum()
    assert abs(one - other) < 1e-5 * np.linalg.norm(p.levels.field(theta)) * np.linalg.norm(v)


def test_the_minimum_stays_the_same_field() -> None:
    one, same = (p.field(solved(p, steps).x) for p, steps in ((plain(problem()), 3000), (problem(), 100)))
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one, same, atol=2e-2 * np.abs(one).max())


def test_it_is_reached_in_fewer_steps() -> None:
    far, end = [], problem().field(solved(problem(), 100).x)
    for p in (plain(problem()), problem()):
        far.append(np.linalg.norm(p.field(solved(p, 20).x) - end))
    assert far[1] < 0.3 * far[0]


def test_groups_hold_every_gaussian_once(monkeypatch: pytest.MonkeyPatch) -> None:
    means = np.random.default_rng(0).normal(size=(1000, 3))
    parts = module._split(means)
    assert sorted(np.concatenate(parts)) == list(range(1000))
    assert min(map(len, parts)) >= module._LEAST > max(map(len, parts)) // 4
    monkeypatch.setattr(module, "GROUPS", 8)
    assert len(module._split(means)) == 8
    assert len(module._split(means[:20])) == 1


def test_groups_move_linearly_in_space() -> None:
    """Fields of groups cost the prior nothing inside a group."""
    p = problem()
    means = np.random.default_rng(0).normal(size=(p.graph.n_gaussians, 3))
    between = module._linear_in_groups(means, 0.5)
    x = (between @ np.random.default_rng(1).normal(size=(between.shape[1], 3))).reshape(-1, ROWS, 3)
    for rows in module._split(means):
        gradient = x[rows[0], 1:]
        np.testing.assert_allclose(x[rows, 1:], np.tile(gradient, (len(rows), 1, 1)))
        shift = (means[rows] - means[rows[0]]) / 0.5 @ gradient
        np.testing.assert_allclose(x[rows, 0], x[rows[0], 0] + shift, atol=1e-12)


def test_a_torch_device_poses_the_same_problem() -> None:
    p = problem(ridge=5.0)
    theta = np.random.default_rng(1).normal(size=(p.n_parameters, 3)).astype(np.float32)
    expected = p.normal(theta)
    found = DeviceProblem(p, "cpu").normal(torch.from_numpy(theta)).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
