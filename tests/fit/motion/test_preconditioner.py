"""Two levels of unknowns: the diagonal is the operator's, the minimum the same, and reached in far fewer steps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import bsr_matrix

from tests.fit.motion.scenes import inner, operator, problem
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.prior.graph import ROWS
from tg4mm.fit.motion.solver.aggregates import Aggregates
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.preconditioner import TwoLevelPreconditioner, information, probe


def plain(o):
    """The same problem with the field itself as unknowns: no scaling, and aggregates that hold nothing."""
    n = o.graph.n_gaussians
    blocks = np.tile(np.eye(ROWS, dtype=np.float32), (n, 1, 1))
    nothing = bsr_matrix((ROWS * n, ROWS), blocksize=(ROWS, ROWS), dtype=np.float32)
    aggregates = Aggregates(o.graph, nothing, np.zeros_like(blocks))
    return replace(
        o, preconditioner=TwoLevelPreconditioner(blocks, aggregates, np.eye(ROWS, dtype=np.float32))
    )


def solved(o, iterations):
    """[N, 6]."""
    shape = (1, *o.views[0].transmittance.shape, 3)
    rng = np.random.default_rng(3)
    pictures = [rng.normal(size=shape).astype(np.float32) for _ in o.views]
    (field,) = o.fields(pcg(o, o.right_hand_sides(pictures), iterations, 0.0).theta)
    return field


def test_the_information_is_the_diagonal_of_the_data():
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


def test_from_field_is_the_transpose():
    pre, rng = operator(problem()).preconditioner, np.random.default_rng(1)
    theta = rng.normal(size=(4 * len(pre.blocks) + len(pre.coarse_factor), 3)).astype(np.float32)
    v = rng.normal(size=(len(pre.blocks) * ROWS, 3)).astype(np.float32)
    one, other = inner(pre.field(theta), v), inner(pre.from_field(v), theta)
    assert abs(one - other) < 1e-5 * np.linalg.norm(pre.field(theta)) * np.linalg.norm(v)


def test_the_minimum_stays_the_same_field():
    o = operator(problem())
    one, same = solved(plain(o), 3000), solved(o, 100)
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one, same, atol=2e-2 * np.abs(one).max())


def test_it_is_reached_in_fewer_iterations():
    o = operator(problem())
    end = solved(o, 100)
    far = [np.linalg.norm(solved(some, 20) - end) for some in (plain(o), o)]
    assert far[1] < 0.3 * far[0]
