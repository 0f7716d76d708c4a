"""Two levels of unknowns: the diagonal is the operator's, the minimum the same, and reached in far fewer steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numba import config, get_num_threads, set_num_threads
from scipy.sparse import bsr_matrix

from tests.motion.test_linear import SCENES, gaussians_of, view_of
from tests.motion.test_problem import problem
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.posing.pose import Problems
from tg4mm.motion.prior.graph import ROWS, graph
from tg4mm.motion.solver import groups as module
from tg4mm.motion.solver import levels as levels_module
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.groups import Groups, groups_of
from tg4mm.motion.solver.levels import Known, Levels, information, probed
from tg4mm.motion.solver.problem import MotionProblem
from tg4mm.motion.solver.solve import CGState, start, step


def plain(p: MotionProblem) -> MotionProblem:
    """The same problem with the field itself as unknowns: no scaling, and groups that hold nothing."""
    n = p.graph.n_gaussians
    blocks = np.tile(np.eye(ROWS, dtype=np.float32), (n, 1, 1))
    nothing = bsr_matrix((ROWS * n, ROWS), blocksize=(ROWS, ROWS), dtype=np.float32)
    groups = Groups(p.graph, nothing, np.zeros_like(blocks))
    return replace(p, levels=Levels(blocks, groups, np.eye(ROWS, dtype=np.float32)))


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
    found = information(probed(p.views, n, np.random.default_rng(0), probes=400))
    np.testing.assert_allclose(found, exact.reshape(n, 2, 3).mean(2), rtol=0.3, atol=1e-6 * exact.max())
    assert found[:, 0].mean() == pytest.approx(exact[:, :3].mean(), rel=0.03)


def test_groups_count_by_what_is_seen_of_them_together() -> None:
    """Against fields of single groups: more than the sum over their Gaussians, by half the way to the middle, twice."""
    scene = SCENES["crowded"]
    gaussians, views = gaussians_of(scene), [view_of(scene)]
    posing = Problems(views, gaussians, MotionConfig(), "cpu")
    n, groups = len(gaussians), posing.groups
    known = Known.of(groups, probed(views, n, np.random.default_rng(0), probes=2000))
    fields = groups.matrix.toarray().T.astype(np.float32)  # [4G, 4N]
    exact = np.zeros(len(fields))
    for k, field in enumerate(fields):
        for axis in range(3):
            x = np.zeros((len(field), 3), np.float32)
            x[:, axis] = field
            exact[k] += sum(float((view.push(posing.graph.motion(x)) ** 2).sum()) for view in views) / 3
    factor = exact / (fields.astype(float) ** 2 @ known.diagonal)
    assert np.median(factor) > 1.05
    expected = fields.astype(float) * known.diagonal @ fields.T.astype(float)
    together = 2 * np.sqrt(factor * np.median(factor))
    expected *= np.sqrt(together[:, None] * together)
    np.testing.assert_allclose(known.between, expected, rtol=0.15, atol=0.01 * expected.max())


@pytest.mark.parametrize("n", [1, 5, 255, 256, 300, 1024])
def test_the_inverse_by_halves_is_the_inverse(n: int) -> None:
    rng = np.random.default_rng(n)
    lower = torch.from_numpy(np.tril(rng.normal(size=(n, n)) / n + 2 * np.eye(n))).float()
    product = levels_module._inverse_lower(lower).double() @ lower.double()
    torch.testing.assert_close(product, torch.eye(n, dtype=torch.float64), rtol=0, atol=1e-5)


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


def cloud(monkeypatch: pytest.MonkeyPatch) -> Groups:
    """Sixteen groups of a cloud of balls."""
    monkeypatch.setattr(module, "GROUPS", 16)
    means = np.random.default_rng(0).normal(size=(800, 3)).astype(np.float32)
    around = graph(means, np.tile(np.eye(3), (800, 1, 1)), np.ones((800, 3)))
    return groups_of(around, means)


def test_fields_of_groups_without_the_matrix_are_those_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """And its transpose."""
    groups, rng = cloud(monkeypatch), np.random.default_rng(1)
    coarse = rng.normal(size=(ROWS * groups.count, 3)).astype(np.float32)
    v = rng.normal(size=(ROWS * 800, 3)).astype(np.float32)
    expected = groups.matrix @ coarse
    np.testing.assert_allclose(groups.field(coarse), expected, atol=1e-5 * np.abs(expected).max())
    expected, before = groups.matrix.T @ v.astype(float), v.copy()
    np.testing.assert_allclose(groups.from_field(v), expected, atol=1e-5 * np.abs(expected).max())
    assert np.array_equal(v, before)


def test_smoothing_makes_fields_cheap_and_keeps_linear_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    groups = cloud(monkeypatch)
    plain, smooth = groups.plain.toarray(), groups.matrix.toarray()
    stiff = groups.graph.blocks.toarray()
    cost = [np.einsum("nk,nk->k", p, stiff @ p) / (p**2).sum(0) for p in (plain, smooth)]
    assert np.median(cost[1]) < 0.4 * np.median(cost[0])
    linear = plain @ np.tile(np.eye(ROWS), (groups.count, 1))[:, :1]  # all groups shifted alike
    np.testing.assert_allclose(smooth @ np.tile(np.eye(ROWS), (groups.count, 1))[:, :1], linear, atol=1e-4)


def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    if config.NUMBA_NUM_THREADS < 2:
        pytest.skip("numba has 1 thread here; comparing thread counts needs 2")
    groups, rng = cloud(monkeypatch), np.random.default_rng(1)
    v, found = rng.normal(size=(ROWS * 800, 3)).astype(np.float32), []
    before = get_num_threads()
    for threads in (1, 2):
        set_num_threads(threads)
        found.append(groups.field(groups.from_field(v)))
    set_num_threads(before)
    assert np.array_equal(*found)


def test_a_torch_device_poses_the_same_problem() -> None:
    p = problem(ridge=5.0)
    theta = np.random.default_rng(1).normal(size=(p.n_parameters, 3)).astype(np.float32)
    expected = p.normal(theta)
    found = DeviceProblem(p, "cpu").normal(torch.from_numpy(theta)).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
