"""Conjugate gradients: they solve, they stop where they should, and systems are each by itself or coupled.

Several levels of unknowns: the diagonal is the operator's, the minimum the same, and reached in far fewer steps, as
many for few Gaussians as for many.
"""

from dataclasses import dataclass, field, replace

import numba
import numpy as np
import pytest
import torch
from scipy.sparse import bsr_matrix, diags

from tests.fit.motion.scenes import draw, inner, operator, problem
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.prior import ROWS, build_graph
from tg4mm.fit.motion.solver import preconditioner
from tg4mm.fit.motion.solver.operator import Array
from tg4mm.fit.motion.solver.pcg import Solution, fetched, pcg, sent
from tg4mm.fit.motion.solver.preconditioner import (
    Aggregates,
    DiagonalEstimate,
    MultilevelPreconditioner,
    aggregate,
    information,
    multilevel_preconditioner,
    probe,
)


@dataclass
class Matrix:
    """A symmetric positive matrix, on each of R systems of [n, 3], or with `couple` [R, R] between them."""

    A: Array
    couple: np.ndarray | None = None
    asked: list[int] = field(default_factory=list)  # rows of each call

    @property
    def is_coupled(self):
        return self.couple is not None

    def products(self, theta, rows=None):
        some = theta if rows is None else theta[list(rows)]
        self.asked.append(len(some))
        if self.couple is None:
            return self.A @ some
        return np.einsum("rs,snc->rnc", self.couple, self.A @ some).astype(theta.dtype)


def system(n=12, dtype=np.float64, systems=1):
    """Systems of condition 50, and right-hand sides [R, n, 3]."""
    rng = np.random.default_rng(0)
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    A = (q * np.linspace(1, 50, n)) @ q.T
    return Matrix(A.astype(dtype)), rng.normal(size=(systems, n, 3)).astype(dtype)


def relative_residual(solution):
    """The largest |b − A θ| / |b|."""
    squares = [float((r**2).sum()) for r in solution.residual]
    return float(np.sqrt(np.max(np.array(squares) / np.maximum(solution.norms, 1e-300))))


def exact(matrix, b):
    A = np.asarray(matrix.A, float)
    whole = np.kron(np.eye(len(b)) if matrix.couple is None else matrix.couple, A)
    return np.linalg.solve(whole, b.reshape(-1, 3).astype(float)).reshape(b.shape)


def test_coupled_systems_are_solved_as_one():
    matrix, b = system(systems=3)
    matrix.couple = np.array([[2.0, 0.5, 0], [0.5, 1, -0.3], [0, -0.3, 3]])
    found = pcg(matrix, b, 108, 1e-9)
    np.testing.assert_allclose(found.theta, exact(matrix, b), atol=1e-5)
    assert found.norms.shape == (1,)
    assert found.norms[0] == pytest.approx((b**2).sum())


def test_groups_are_each_a_system_as_they_would_be_alone():
    """Two of two parts each; the one that asks for less ends first."""
    matrix, b = system(systems=4)
    b[:2] = np.linalg.eigh(matrix.A)[1][:, :1]  # an eigenvector: solved by one iteration
    found = pcg(matrix, b, 30, 1e-6, together=2)
    assert found.norms.shape == (2,)
    assert matrix.asked[0] == 4
    assert matrix.asked[-1] == 2
    np.testing.assert_allclose(found.theta, exact(matrix, b), atol=1e-4)
    one = pcg(matrix, b[2:], 5, 0.0, together=2).theta
    np.testing.assert_array_equal(pcg(matrix, b, 5, 0.0, together=2).theta[2:], one)
    assert np.abs(one - pcg(matrix, b[2:], 5, 0.0).theta).max() > 1e-6  # not one by one


def test_each_iteration_is_the_best_in_its_krylov_space():
    """Directions are conjugate: the answer after k is the minimum over span(b, A b, … Aᵏ⁻¹ b)."""
    matrix, b = system()
    A, k = np.kron(matrix.A, np.eye(3)), 5
    krylov = np.linalg.qr(np.stack([np.linalg.matrix_power(A, i) @ b.ravel() for i in range(k)], 1))[0]
    best = krylov @ np.linalg.solve(krylov.T @ A @ krylov, krylov.T @ b.ravel())
    np.testing.assert_allclose(pcg(matrix, b, k, 0.0).theta.ravel(), best, atol=1e-8)


def test_the_tolerance_is_measured_against_the_norms_given():
    """A second pass begins with a small residual: of what was asked first it is little."""
    matrix, b = system()
    pcg(matrix, b, 30, 0.1, norms=100.0 * (b**2).sum((1, 2)))
    assert not matrix.asked
    pcg(matrix, b, 30, 0.1)
    assert matrix.asked


def test_tensors_are_solved_as_arrays_are():
    matrix, b = system(dtype=np.float32, systems=2)
    there = Matrix(torch.from_numpy(matrix.A))
    a: Solution = pcg(matrix, b, 6, 0.0)
    t: Solution = pcg(there, torch.from_numpy(b), 6, 0.0)
    assert isinstance(t.theta, torch.Tensor)
    np.testing.assert_allclose(t.theta.numpy(), a.theta, atol=1e-5)
    assert relative_residual(t) == pytest.approx(relative_residual(a), rel=1e-3)
    np.testing.assert_array_equal(fetched(t.theta), t.theta.numpy())
    assert sent(b, "cpu") is b


def plain(o):
    """The same problem with the field itself as unknowns: no scaling, and aggregates that hold nothing."""
    n = o.graph.n_gaussians
    blocks = np.tile(np.eye(ROWS, dtype=np.float32), (n, 1, 1))
    nothing = bsr_matrix((ROWS * n, ROWS), blocksize=(ROWS, ROWS), dtype=np.float32)
    one = np.eye(ROWS, dtype=np.float32)
    aggregates = Aggregates(o.graph, nothing, bsr_matrix(one, blocksize=one.shape), np.zeros_like(blocks))
    own = MultilevelPreconditioner(blocks, aggregates, np.zeros((1, ROWS, ROWS), np.float32), one)
    return replace(o, preconditioner=own)


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


@pytest.mark.parametrize("patches", [False, True])
def test_from_field_is_the_transpose(patches):
    o, rng = operator(problem(patches=patches)), np.random.default_rng(1)
    pre, theta = o.preconditioner, draw(o, 1)[0]
    assert bool(pre.patch_blocks.any()) == patches
    v = rng.normal(size=(len(pre.blocks) * ROWS, 3)).astype(np.float32)
    one, other = inner(pre.field(theta), v), inner(pre.from_field(v), theta)
    assert abs(one - other) < 1e-5 * np.linalg.norm(pre.field(theta)) * np.linalg.norm(v)


@pytest.mark.parametrize("patches", [False, True])
def test_the_minimum_stays_the_same_field(patches):
    o = operator(problem(patches=patches))
    one, same = solved(plain(o), 3000), solved(o, 100)
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one, same, atol=2e-2 * np.abs(one).max())


def test_the_number_of_threads_does_not_change_a_bit():
    o, before = operator(problem(patches=True)), numba.get_num_threads()
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("numba has one thread here; comparing thread counts needs 2")
    found = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        solution = pcg(o, draw(o, 5), 4, 0.0)
        found.append([solution.theta, o.fields(solution.theta), o.gradient_fields(solution.theta)])
    numba.set_num_threads(before)
    assert all(np.array_equal(a, b) and a.any() for a, b in zip(*found, strict=True))


def test_it_is_reached_in_fewer_iterations():
    o = operator(problem())
    end = solved(o, 100)
    far = [np.linalg.norm(solved(some, 20) - end) for some in (plain(o), o)]
    assert far[1] < 0.3 * far[0]


@dataclass
class Sheet:
    """Gaussians at random places of a square, that the prior holds together and weak pictures hold where they are."""

    n: int
    is_coupled = False

    def __post_init__(self):
        self.means = np.random.default_rng(0).random((self.n, 3)) * [1, 1, 0.01]
        axes, scales = np.tile(np.eye(3), (self.n, 1, 1)), np.full((self.n, 3), 0.01)
        self.graph = build_graph(self.means, axes, scales)
        aggregates, diagonal = aggregate(self.graph, self.means), np.tile([1.0, 0, 0, 0], self.n)
        images = DiagonalEstimate(1.0, diagonal, aggregates.galerkin(diags(diagonal)))
        self.weight = np.float32(diagonal[:, None])
        self.preconditioner = multilevel_preconditioner(aggregates, images, 300.0, 1e-3)

    def products(self, theta, rows=None):
        out = []
        for one in theta:
            x = self.preconditioner.field(one)
            v = self.weight * x
            self.graph.add_prior(x, 300.0, 1e-3, v)
            out.append(self.preconditioner.from_field(v))
        return np.stack(out)

    def iterations(self):
        """Until the residual is 1 %, of what shows a sway and noise."""
        shown = self.weight * np.random.default_rng(1).normal(size=(4 * self.n, 3))
        shown[::4] += 3 * np.cos(6 * self.means)
        residuals = []
        b = self.preconditioner.from_field(shown.astype(np.float32))[None]
        pcg(self, b, 200, 1e-2, update=lambda _, residual: residuals.append(residual))
        assert residuals[-1] < 1e-2
        return len(residuals)


def test_many_gaussians_take_as_many_iterations_as_few(monkeypatch):
    monkeypatch.setattr(preconditioner, "MOST", 16)
    few, many = Sheet(1_100), Sheet(17_600)
    assert many.preconditioner.aggregates.has_patches
    assert many.iterations() <= 1.5 * few.iterations()
    # without patches it takes more
    monkeypatch.setattr(preconditioner, "_LEAST", 1_000)
    alone = Sheet(17_600)
    assert not alone.preconditioner.aggregates.has_patches
    assert alone.iterations() > 2 * many.iterations()
