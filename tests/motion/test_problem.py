"""The least-squares problem of one component: its operator, its right-hand side, its scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.motion.test_view_jacobian import gaussians_of, view_of
from tests.rasterize.oracle import make_scene
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.posing.pose import Problems
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.preconditioner import DiagonalEstimate, information, probe, two_level_preconditioner
from tg4mm.motion.solver.problem import MotionProblem

N = 40


def problem(neighbours: float = 3.0, ridge: float = 0.1, weighted: bool = False) -> MotionProblem:
    """Two cameras look at one cloud of 40 Gaussians; `weighted`: their pixels count 0.2 to 1."""
    scene = make_scene(0, cameras=2)
    views = [
        view_of(replace(scene, viewmats=scene.viewmats[c : c + 1], Ks=scene.Ks[c : c + 1])) for c in (0, 1)
    ]
    weights = None
    if weighted:
        shape = (2, *views[0].transmittance.shape)
        weights = np.random.default_rng(7).uniform(0.2, 1, shape).astype(np.float32)
    rng = np.random.default_rng(0)
    posing = Problems(views, gaussians_of(scene), MotionConfig(), "cpu")
    estimate = DiagonalEstimate.of(posing.groups, probe(views, N, rng, weights))
    unknowns = two_level_preconditioner(
        posing.groups, estimate, estimate.scale * neighbours, estimate.scale * ridge
    )
    config = MotionConfig(neighbours=neighbours, ridge=ridge)
    return MotionProblem(views, posing.graph, unknowns, estimate.scale, config, weights)


def draw(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(problem().n_parameters, 3)).astype(np.float32)


def inner(a: np.ndarray, b: np.ndarray) -> float:
    return float((a.astype(np.float64) * b).sum())


def test_the_operator_is_symmetric() -> None:
    p, a, b = problem(), draw(1), draw(2)
    scale = np.sqrt(inner(a, p.normal(a)) * inner(b, p.normal(b)))
    assert abs(inner(a, p.normal(b)) - inner(b, p.normal(a))) < 1e-4 * scale


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(("neighbours", "ridge"), [(0.0, 1e-3), (3.0, 1e-3), (0.0, 0.1), (3.0, 0.1)])
def test_its_energy_is_the_sum_that_is_minimised(neighbours: float, ridge: float, weighted: bool) -> None:
    """θ·Aθ = Σ W |J m|² + h (λ x·Kx + μ |x|²), each term by itself."""
    p, theta = problem(neighbours, ridge, weighted), draw(1)
    x = p.levels.field(theta)
    motion, data = p.graph.motion(x), 0.0
    for k, view in enumerate(p.views):
        squares = view.jvp(motion[None])[0].astype(np.float64) ** 2
        data += float((squares * (1 if p.weights is None else p.weights[k, ..., None])).sum())
    expected = data + p.scale * (neighbours * inner(x, p.graph.stiffness @ x) + ridge * inner(x, x))
    assert inner(theta, p.normal(theta)) == pytest.approx(expected, rel=1e-3)
    assert p.normal(theta).dtype == np.float32


@pytest.mark.parametrize("weighted", [False, True])
def test_the_right_hand_side_is_the_transpose_of_what_a_field_shows(weighted: bool) -> None:
    p, theta, rng = problem(weighted=weighted), draw(1), np.random.default_rng(3)
    shown = [view.jvp(p.field(theta)[None])[0] for view in p.views]
    pictures = np.stack([rng.normal(size=s.shape) for s in shown]).astype(np.float32)
    counted = pictures if p.weights is None else pictures * p.weights[..., None]
    expected = sum(inner(s, d) for s, d in zip(shown, counted, strict=True))
    size = np.linalg.norm(np.stack(shown)) * np.linalg.norm(pictures)
    assert abs(inner(p.right_hand_side(pictures), theta) - expected) < 1e-5 * size


def test_the_scale_is_the_mean_diagonal_of_the_information() -> None:
    """Column by column, against random signs."""
    p, total = problem(), 0.0
    for i in range(N):
        for k in range(3):
            motion = np.zeros((N, DOF), np.float32)
            motion[i, k] = 1
            total += sum(inner(view.jvp(motion[None])[0], view.jvp(motion[None])[0]) for view in p.views)
    many = information(probe(p.views, N, np.random.default_rng(1), probes=200))[:, 0].mean()
    assert many == pytest.approx(total / (3 * N), rel=0.1)


def test_several_components_at_once_are_each_by_itself() -> None:
    """The operator and the right-hand side, to rounding; one more between them changes nothing."""
    p, rng = problem(), np.random.default_rng(5)
    thetas = [draw(k) for k in (1, 2, 3)]
    for found, theta in zip(p.normals(thetas), thetas, strict=True):
        np.testing.assert_allclose(found, p.normal(theta), rtol=1e-5, atol=1e-5 * np.abs(found).max())
    height, width = p.views[0].transmittance.shape
    pictures = rng.normal(size=(2, 3, height, width, 3)).astype(np.float32)
    for k, found in enumerate(p.right_hand_sides(pictures)):
        alone = p.right_hand_side(pictures[:, k])
        np.testing.assert_allclose(found, alone, rtol=1e-5, atol=1e-5 * np.abs(found).max())


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("device", [None, "cpu"])
def test_the_problems_of_the_parts_add_up_to_the_whole(device: str | None, weighted: bool) -> None:
    """Data and prior both, on numpy arrays and on torch tensors: each part's prior is as much weaker."""
    p = problem(weighted=weighted)
    theta = draw(1)
    if device is None:
        whole, parts = p.normal(theta), [p.of_views(np.array([i])).normal(theta) for i in (0, 1)]
    else:
        q, t = DeviceProblem(p, device), torch.from_numpy(theta)
        whole, parts = q.normal(t).numpy(), [q.of_views(np.array([i])).normal(t).numpy() for i in (0, 1)]
    assert not np.allclose(parts[0], parts[1], atol=1e-2 * np.abs(whole).max())
    np.testing.assert_allclose(sum(parts), whole, atol=1e-5 * np.abs(whole).max())
