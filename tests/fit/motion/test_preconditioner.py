"""Two levels of unknowns: the diagonal is the operator's, the minimum the same, and reached in far fewer steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numba import config, get_num_threads, set_num_threads
from scipy.sparse import bsr_matrix

from tests.fit.motion.scenes import SCENES, gaussians_of, inner, operator, problem, view_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.prior.graph import ROWS, build_graph
from tg4mm.fit.motion.solver import aggregates as module
from tg4mm.fit.motion.solver import preconditioner as preconditioner_module
from tg4mm.fit.motion.solver.aggregates import Aggregates, aggregate
from tg4mm.fit.motion.solver.cpu import CpuOperator
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.preconditioner import (
    DiagonalEstimate,
    TwoLevelPreconditioner,
    information,
    probe,
)
from tg4mm.fit.motion.solver.problem import Problem


def plain(o: CpuOperator) -> CpuOperator:
    """The same problem with the field itself as unknowns: no scaling, and aggregates that hold nothing."""
    n = o.graph.n_gaussians
    blocks = np.tile(np.eye(ROWS, dtype=np.float32), (n, 1, 1))
    nothing = bsr_matrix((ROWS * n, ROWS), blocksize=(ROWS, ROWS), dtype=np.float32)
    aggregates = Aggregates(o.graph, nothing, np.zeros_like(blocks))
    return replace(
        o, preconditioner=TwoLevelPreconditioner(blocks, aggregates, np.eye(ROWS, dtype=np.float32))
    )


def solved(o: CpuOperator, iterations: int) -> np.ndarray:
    """[N, 6]."""
    shape = (1, *o.views[0].transmittance.shape, 3)
    rng = np.random.default_rng(3)
    pictures = [rng.normal(size=shape).astype(np.float32) for _ in o.views]
    (field,) = o.fields(pcg(o, o.right_hand_sides(pictures), iterations, 0.0).theta)
    return field


def test_the_information_is_the_diagonal_of_the_data() -> None:
    """Against single motions of every Gaussian; mean over x, y, z."""
    p = problem()
    n = p.n_gaussians
    exact = np.zeros((n, DOF))
    for i in range(n):
        for k in range(DOF):
            motion = np.zeros((n, DOF), np.float32)
            motion[i, k] = 1
            exact[i, k] = sum(
                float((view.jvp(motion[None]).astype(np.float64) ** 2).sum()) for view in p.views
            )
    found = information(probe(p.views, n, np.random.default_rng(0), probes=400))
    np.testing.assert_allclose(found, exact.reshape(n, 2, 3).mean(2), rtol=0.3, atol=1e-6 * exact.max())
    assert found[:, 0].mean() == pytest.approx(exact[:, :3].mean(), rel=0.03)


def test_aggregates_count_by_what_is_seen_of_them_together() -> None:
    """Against fields of single aggregates: more than the sum over their Gaussians, halfway to the median, twice."""
    scene = SCENES["crowded"]
    gaussians, views = gaussians_of(scene), [view_of(scene)]
    whole = Problem.of(views, gaussians, MotionConfig(), "cpu")
    n, aggregates = len(gaussians), whole.aggregates
    estimate = DiagonalEstimate.of(aggregates, probe(views, n, np.random.default_rng(0), probes=2000))
    fields = aggregates.matrix.toarray().T.astype(np.float32)  # [4G, 4N]
    exact = np.zeros(len(fields))
    for k, field in enumerate(fields):
        for axis in range(3):
            x = np.zeros((len(field), 3), np.float32)
            x[:, axis] = field
            exact[k] += sum(float((view.jvp(whole.graph.motion(x)[None]) ** 2).sum()) for view in views) / 3
    factor = exact / (fields.astype(float) ** 2 @ estimate.diagonal)
    assert np.median(factor) > 1.05
    expected = fields.astype(float) * estimate.diagonal @ fields.T.astype(float)
    together = 2 * np.sqrt(factor * np.median(factor))
    expected *= np.sqrt(together[:, None] * together)
    np.testing.assert_allclose(estimate.coarse, expected, rtol=0.15, atol=0.01 * expected.max())


@pytest.mark.parametrize("n", [1, 5, 255, 256, 300, 1024])
def test_the_inverse_by_halves_is_the_inverse(n: int) -> None:
    rng = np.random.default_rng(n)
    lower = torch.from_numpy(np.tril(rng.normal(size=(n, n)) / n + 2 * np.eye(n))).float()
    product = preconditioner_module._inverse_lower(lower).double() @ lower.double()
    torch.testing.assert_close(product, torch.eye(n, dtype=torch.float64), rtol=0, atol=1e-5)


def test_from_field_is_the_transpose() -> None:
    pre, rng = operator(problem()).preconditioner, np.random.default_rng(1)
    theta = rng.normal(size=(4 * len(pre.blocks) + len(pre.coarse_factor), 3)).astype(np.float32)
    v = rng.normal(size=(len(pre.blocks) * ROWS, 3)).astype(np.float32)
    one, other = inner(pre.field(theta), v), inner(pre.from_field(v), theta)
    assert abs(one - other) < 1e-5 * np.linalg.norm(pre.field(theta)) * np.linalg.norm(v)


def test_the_minimum_stays_the_same_field() -> None:
    o = operator(problem())
    one, same = solved(plain(o), 3000), solved(o, 100)
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one, same, atol=2e-2 * np.abs(one).max())


def test_it_is_reached_in_fewer_iterations() -> None:
    o = operator(problem())
    end = solved(o, 100)
    far = [np.linalg.norm(solved(some, 20) - end) for some in (plain(o), o)]
    assert far[1] < 0.3 * far[0]


def test_aggregates_hold_every_gaussian_once(monkeypatch: pytest.MonkeyPatch) -> None:
    means = np.random.default_rng(0).normal(size=(1000, 3))
    regions = module._split(means)
    assert sorted(np.concatenate(regions)) == list(range(1000))
    assert min(map(len, regions)) >= module._LEAST > max(map(len, regions)) // 4
    monkeypatch.setattr(module, "MOST", 8)
    assert len(module._split(means)) == 8
    assert len(module._split(means[:20])) == 1


def test_groups_move_linearly_in_space() -> None:
    """Fields of aggregates cost the prior nothing inside one."""
    p = problem()
    means = np.random.default_rng(0).normal(size=(p.graph.n_gaussians, 3))
    between = module._tentative(means, 0.5)
    x = (between @ np.random.default_rng(1).normal(size=(between.shape[1], 3))).reshape(-1, ROWS, 3)
    for rows in module._split(means):
        gradient = x[rows[0], 1:]
        np.testing.assert_allclose(x[rows, 1:], np.tile(gradient, (len(rows), 1, 1)))
        shift = (means[rows] - means[rows[0]]) / 0.5 @ gradient
        np.testing.assert_allclose(x[rows, 0], x[rows[0], 0] + shift, atol=1e-12)


def cloud(monkeypatch: pytest.MonkeyPatch) -> Aggregates:
    """Sixteen aggregates of a cloud of balls."""
    monkeypatch.setattr(module, "MOST", 16)
    means = np.random.default_rng(0).normal(size=(800, 3)).astype(np.float32)
    around = build_graph(means, np.tile(np.eye(3), (800, 1, 1)), np.ones((800, 3)))
    return aggregate(around, means)


def test_fields_of_aggregates_without_the_matrix_are_those_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """And its transpose."""
    aggregates, rng = cloud(monkeypatch), np.random.default_rng(1)
    coarse = rng.normal(size=(ROWS * aggregates.count, 3)).astype(np.float32)
    v = rng.normal(size=(ROWS * 800, 3)).astype(np.float32)
    expected = aggregates.matrix @ coarse
    np.testing.assert_allclose(aggregates.field(coarse), expected, atol=1e-5 * np.abs(expected).max())
    expected, before = aggregates.matrix.T @ v.astype(float), v.copy()
    np.testing.assert_allclose(aggregates.from_field(v), expected, atol=1e-5 * np.abs(expected).max())
    assert np.array_equal(v, before)


def test_smoothing_makes_fields_cheap_and_keeps_linear_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    aggregates = cloud(monkeypatch)
    plain, smooth = aggregates.tentative.toarray(), aggregates.matrix.toarray()
    stiff = aggregates.graph.blocks.toarray()
    cost = [np.einsum("nk,nk->k", p, stiff @ p) / (p**2).sum(0) for p in (plain, smooth)]
    assert np.median(cost[1]) < 0.4 * np.median(cost[0])
    linear = plain @ np.tile(np.eye(ROWS), (aggregates.count, 1))[:, :1]  # all aggregates shifted alike
    np.testing.assert_allclose(
        smooth @ np.tile(np.eye(ROWS), (aggregates.count, 1))[:, :1], linear, atol=1e-4
    )


def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    if config.NUMBA_NUM_THREADS < 2:
        pytest.skip("numba has 1 thread here; comparing thread counts needs 2")
    aggregates, rng = cloud(monkeypatch), np.random.default_rng(1)
    v, found = rng.normal(size=(ROWS * 800, 3)).astype(np.float32), []
    before = get_num_threads()
    for threads in (1, 2):
        set_num_threads(threads)
        found.append(aggregates.field(aggregates.from_field(v)))
    set_num_threads(before)
    assert np.array_equal(*found)
