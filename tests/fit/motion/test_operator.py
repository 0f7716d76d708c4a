"""The operator of the motion problem, on the CPU and on a torch device: against its matrices, written out."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import pytest
import torch

from tests.fit.motion.scenes import N, draw, inner, operator, problem, weights_of
from tests.fit.rasterize.oracle import assert_close
from tests.helpers.cuda import needs_cuda
from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.nuisance.projection import EXPOSURE
from tg4mm.fit.motion.prior import ROWS, reweight_edges
from tg4mm.fit.motion.solver import cuda
from tg4mm.fit.motion.solver.cpu import CpuOperator, SharedPass
from tg4mm.fit.motion.solver.cuda import DeviceOperator, DeviceViews
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.split_half import chessboard

RIDGE, SMOOTH = 0.1, 3.0
EXACT = 2e-5  # of the largest entry: float32 sums in another order
FIELDS = 3
ALL = slice(0, 12)
KINDS = {
    "plain": {},
    "patches": {"patches": True},
    "weighted": {"weighted": True},
    "nuisance": {"nuisance": ALL},
    "weighted nuisance": {"weighted": True, "nuisance": ALL},
    "mixed": {"mixed": True},
    "supported": {"mixed": True, "supported": True},
    "all": {"weighted": True, "nuisance": EXPOSURE, "mixed": True},
    "all, supported": {"weighted": True, "nuisance": EXPOSURE, "mixed": True, "supported": True},
}


@lru_cache
def made(kind):
    settings = dict(KINDS[kind])
    weighted = settings.pop("weighted", False)
    return operator(problem(RIDGE, **settings), SMOOTH, weighted)


@lru_cache
def jacobians():
    """[H · W · 3, 6 N] float64 of each view, column by column."""
    unit = np.eye(N * DOF, dtype=np.float32).reshape(-1, N, DOF)
    return [v.jvp(unit).reshape(N * DOF, -1).T.astype(np.float64) for v in made("plain").views]


@dataclass(frozen=True)
class Dense:
    """The problem of an operator with matrices: x and motions as vectors, one field after the other."""

    of: CpuOperator

    @cached_property
    def motion(self):
        """[6 N, 12 N]: x to displacement and rotation."""
        unit = np.eye(ROWS * N * 3, dtype=np.float32).reshape(-1, ROWS * N, 3)
        return np.stack([self.of.graph.motion(x).ravel() for x in unit], 1).astype(np.float64)

    @property
    def support(self):
        """[R, 6 N] of 0 and 1."""
        return 1.0 if self.of.support is None else np.repeat(self.of.support.astype(np.float64), DOF, 1)

    def metric_times(self, k, pictures):
        """(W − W P (Pᵀ W P)⁻¹ Pᵀ W) of target images, one after the other; by P as it is, not made orthonormal."""
        o = self.of
        height, width = o.views[k].transmittance.shape
        weights = np.ones((height, width)) if o.weights is None else o.weights[k].astype(np.float64)
        w = np.repeat(weights.ravel(), 3)[:, None]
        flat = pictures.reshape(-1, len(w)).T
        out = w * flat
        if o.projections is not None:
            p = o.projections[k]
            columns = p.nuisance.columns(p.mean).reshape(-1, len(w)).T.astype(np.float64)
            columns /= np.linalg.norm(columns, axis=0)
            gram = np.linalg.pinv(columns.T @ (w * columns), rcond=1e-8)
            out -= w * (columns @ (gram @ (columns.T @ out)))
        return np.asarray(out.T.ravel())

    def shown(self, k, motions):
        """View k's target images of motions [R, 6 N], one after the other."""
        mix = np.eye(FIELDS) if self.of.mixing is None else self.of.mixing[k].astype(np.float64)
        return np.asarray((mix @ motions @ jacobians()[k].T).ravel())

    def gathered(self, k, pictures):
        """The transpose of `shown`: [R, 6 N]."""
        mix = np.eye(FIELDS) if self.of.mixing is None else self.of.mixing[k].astype(np.float64)
        return np.asarray(mix.T @ pictures.reshape(len(mix), -1) @ jacobians()[k])

    def product(self, x):
        """The product with fields x [R, 4 N, 3]."""
        o, motions = self.of, (x.reshape(FIELDS, -1) @ self.motion.T) * self.support
        data = np.zeros_like(motions)
        for k in range(len(o.views)):
            data += self.gathered(k, self.metric_times(k, self.shown(k, motions)))
        stiffness = o.graph.stiffness.astype(np.float64)
        prior = np.stack([o.smoothness_weight * (stiffness @ one) + o.ridge * one for one in x])
        return np.asarray((data * self.support @ self.motion).reshape(x.shape) + o.scale * prior)

    def right_hand_side(self, pictures):
        total = np.zeros((FIELDS, N * DOF))
        for k, shown in enumerate(pictures):
            total += self.gathered(k, self.metric_times(k, shown.astype(np.float64).ravel()))
        return np.asarray((total * self.support @ self.motion).reshape(FIELDS, -1, 3))

    def misfit(self, fields, pictures):
        total = 0.0
        for k, shown in enumerate(pictures):
            left = self.shown(k, fields.astype(np.float64).reshape(FIELDS, -1)) - shown.ravel()
            total += float(left @ self.metric_times(k, left))
        return total


def pictures_of(o, seed=3):
    """Target images of each view."""
    rng = np.random.default_rng(seed)
    count = FIELDS if o.mixing is None else len(o.mixing[0])
    shape = (count, *o.views[0].transmittance.shape, 3)
    return [rng.normal(size=shape).astype(np.float32) for _ in o.views]


def in_unknowns(o, v):
    return np.stack([o.preconditioner.from_field(one.astype(np.float32)) for one in v])


def close(found, expected, tolerance):
    return bool(np.abs(found - expected).max() < tolerance * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_its_products_are_those_with_the_matrices(kind):
    o = made(kind)
    theta = draw(o, 1, FIELDS)
    expected = in_unknowns(o, Dense(o).product(o.gradient_fields(theta).astype(np.float64)))
    assert close(o.products(theta), expected, 2e-4)
    assert o.products(theta).dtype == np.float32


@pytest.mark.parametrize("kind", KINDS)
def test_its_right_hand_sides_are_those_with_the_matrices(kind):
    o = made(kind)
    expected = in_unknowns(o, Dense(o).right_hand_side(pictures_of(o)))
    assert close(o.right_hand_sides(pictures_of(o)), expected, 2e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_its_misfit_is_what_fields_leave(kind):
    o = made(kind)
    fields, pictures = o.fields(30 * draw(o, 1, FIELDS)), pictures_of(o)
    expected = Dense(o).misfit(fields, pictures)
    assert o.misfit(fields, pictures) == pytest.approx(expected, rel=1e-4)
    assert o.misfit(0 * fields, pictures) != pytest.approx(expected, rel=1e-2)


def test_projecting_out_is_least_squares_with_the_nuisance_beside_the_motion():
    """The minimum over motion and coefficients together, by a dense solver."""
    o = made("weighted nuisance")
    dense, pictures = Dense(replace(o, projections=None)), pictures_of(o)
    rows, right = [], []
    for k, p in enumerate(o.projections or []):
        root = np.repeat(np.sqrt(o.weights[k].ravel().astype(np.float64)), 3)[:, None]
        columns = p.nuisance.columns(p.mean).reshape(-1, len(root)).T.astype(np.float64)
        columns /= np.linalg.norm(columns, axis=0)
        own = [np.zeros_like(columns), np.zeros_like(columns)]
        own[k] = columns
        rows.append(root * np.hstack([jacobians()[k] @ dense.motion, *own]))
        right.append(root[:, 0] * pictures[k][0].ravel())
    prior = np.kron((o.smoothness_weight * o.graph.stiffness.astype(np.float64)).toarray(), np.eye(3))
    values, vectors = np.linalg.eigh(o.scale * (prior + o.ridge * np.eye(len(prior))))
    both = np.hstack([np.sqrt(np.maximum(values, 0))[:, None] * vectors.T, np.zeros((len(prior), 24))])
    wanted = np.concatenate([*right, np.zeros(len(prior))])
    answer = np.linalg.lstsq(np.vstack([*rows, both]), wanted, rcond=None)
    x = answer[0][: len(prior)].reshape(1, -1, 3)
    b = o.right_hand_sides([p[:1] for p in pictures])
    left = in_unknowns(o, Dense(o).product(np.repeat(x, FIELDS, 0)))[:1] - b
    assert np.linalg.norm(left) < 1e-3 * np.linalg.norm(b)
    without = in_unknowns(o, dense.product(np.repeat(x, FIELDS, 0)))[:1] - b
    assert np.linalg.norm(without) > 0.1 * np.linalg.norm(b)


def folds(p, by_pixels):
    if not by_pixels:
        return [Fold(np.array([k])) for k in (0, 1)]
    board, rows = chessboard(p.size), np.arange(2)
    return [Fold(rows, board), Fold(rows, 1 - board)]


@pytest.mark.parametrize("by_pixels", [False, True])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_problems_of_two_folds_add_up_to_the_whole(weighted, by_pixels):
    """Data and prior both: each fold's prior is as much weaker."""
    p = problem(RIDGE)
    p = p.changed(pixel_weights=weights_of(p)) if weighted else p
    whole, halves = p.on_cpu(p.everything, SMOOTH), folds(p, by_pixels)
    parts = [p.on_cpu(fold, SMOOTH) for fold in halves]
    theta, pictures = draw(whole, 1, FIELDS), pictures_of(whole)
    expected = whole.products(theta)
    products = [o.products(theta) for o in parts]
    assert not close(products[0], products[1], 1e-2)
    np.testing.assert_allclose(sum(products), expected, atol=2e-5 * np.abs(expected).max())
    sides = [o.right_hand_sides([pictures[v] for v in f.views]) for o, f in zip(parts, halves, strict=True)]
    assert close(sum(sides), whole.right_hand_sides(pictures), 1e-5)


def test_a_changed_problem_keeps_nothing_of_the_old_one():
    """Its preconditioner and the scale of its prior are those of the new weights; within one they are made once."""
    p = problem(RIDGE)
    old, new = operator(p), operator(p.changed(pixel_weights=0.25 * weights_of(p)))
    assert new.scale < 0.5 * old.scale
    assert not np.array_equal(new.preconditioner.blocks, old.preconditioner.blocks)
    assert operator(p).preconditioner is old.preconditioner


@pytest.mark.parametrize("mixed", [False, True])
def test_operators_that_share_a_pass_are_each_by_itself(mixed):
    """One field each, or three that are mixed."""
    p = problem(RIDGE, mixed=mixed)
    several = [p.on_cpu(p.everything, weight) for weight in (0.1, 3.0, 300.0)]
    n = FIELDS if mixed else 1
    shared, theta = SharedPass(several), draw(several[0], 1, 3 * n)
    parts = [o.products(theta[k * n : (k + 1) * n]) for k, o in enumerate(several)]
    assert close(shared.products(theta), np.concatenate(parts), 1e-5)
    rows = list(range(2 * n, 3 * n))
    assert close(shared.products(theta, rows), parts[2], 1e-5)
    pictures = [picture if mixed else picture[:1] for picture in pictures_of(several[0])]
    sides = np.concatenate([o.right_hand_sides(pictures) for o in several])
    assert close(shared.right_hand_sides(pictures), sides, 1e-5)


def on_device(o, where, storage=torch.float32):
    return DeviceOperator(o, DeviceViews(o.views, o.graph, where, storage))


def check_device(kind, where, tolerance):
    ours, pictures = made(kind), pictures_of(made(kind))
    other, theta = on_device(ours, where), draw(ours, 1, FIELDS)
    there = torch.from_numpy(theta).to(where)

    def same(name, a, b):
        a = a if isinstance(a, torch.Tensor) else torch.from_numpy(a)
        assert_close(name, a.cpu(), torch.from_numpy(b), tolerance)

    same("products", other.products(there), ours.products(theta))
    same("right-hand sides", other.right_hand_sides(pictures), ours.right_hand_sides(pictures))
    same("fields", other.fields(there), ours.fields(theta))
    x = ours.gradient_fields(theta)
    same("gradients", other.gradient_fields(there), x)
    same("prior", other.prior_products(x), ours.prior_products(x))
    misfit = ours.misfit(ours.fields(theta), pictures)
    assert other.misfit(ours.fields(theta), pictures) == pytest.approx(misfit, rel=100 * tolerance)


@pytest.mark.parametrize("kind", KINDS)
def test_a_torch_device_poses_the_same_problem(kind):
    check_device(kind, "cpu", EXACT)


@needs_cuda
@pytest.mark.parametrize("kind", KINDS)
def test_cuda_poses_the_same_problem(kind):
    check_device(kind, "cuda", 1e-4)


def check_reweighted(where, tolerance):
    ours = made("plain")
    other = on_device(ours, where)
    residual = np.random.default_rng(4).random(len(ours.graph.other)).astype(np.float32) ** 8
    looser = reweight_edges(ours.graph, residual)
    theta = draw(ours, 1, FIELDS)
    expected = ours.with_graph(looser).products(theta)
    found = other.with_graph(looser).products(torch.from_numpy(theta).to(where)).cpu()
    assert_close("products", found, torch.from_numpy(expected), tolerance)
    assert not close(ours.products(theta), expected, 1e-2)


def test_a_torch_device_takes_reweighted_edges_too():
    check_reweighted("cpu", EXACT)


@needs_cuda
def test_cuda_takes_reweighted_edges_too():
    check_reweighted("cuda", 1e-4)


@pytest.mark.parametrize("kind", ["plain", "all"])
def test_of_half_precision_it_stays_symmetric(kind):
    """What was rounded is the same in both directions."""
    o = on_device(made(kind), "cpu", torch.float16)
    a, b = (torch.from_numpy(draw(made(kind), k, FIELDS)) for k in (1, 2))
    ab, ba, aa, bb = (inner(x.numpy(), o.products(y).numpy()) for x, y in ((a, b), (b, a), (a, a), (b, b)))
    assert abs(ab - ba) < 1e-5 * np.sqrt(aa * bb)


def test_memory_that_is_too_small_is_one_line(monkeypatch):
    def exhausted(*_):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nmore lines")

    monkeypatch.setattr(cuda, "device_view_jacobian", exhausted)
    with pytest.raises(Tg4mmError, match=r"\A[^\n]*device cpu has: it holds 0 of 2 views[^\n]*\Z"):
        on_device(made("plain"), "cpu")
