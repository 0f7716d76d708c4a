"""The scaled parameters: the diagonal is that of the operator, the minimum the same, and reached in fewer steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.motion.test_problem import problem
from tg4mm.motion.condition import conditioned, diagonals
from tg4mm.motion.device import DeviceProblem
from tg4mm.motion.problem import MotionProblem
from tg4mm.motion.solve import CGState, start, step


def uneven() -> MotionProblem:
    """Half the parameters reach their Gaussians thirty times more weakly."""
    p = problem(neighbours=3.0, ridge=0.01)
    weak = np.where(np.arange(p.n_parameters) % 2, 1.0, 1 / 30).astype(np.float32)
    return replace(p, sampling=(p.sampling.multiply(weak[None])).tocsr())


def scaled_problem(p: MotionProblem, seed: int = 0) -> MotionProblem:
    return conditioned(p, diagonals(p, np.random.default_rng(seed)))


def pictures(p: MotionProblem) -> np.ndarray:
    height, width = p.views[0].transmittance.shape
    return np.random.default_rng(3).normal(size=(len(p.views), height, width, 3)).astype(np.float32)


def solved(p: MotionProblem, steps: int) -> CGState:
    state = start(p.right_hand_side(pictures(p)))
    for _ in range(steps):
        state = step(state, p.normal)
    return state


def test_the_diagonal_is_the_operators() -> None:
    """Against the operator on every unit vector; the mean over x, y, z."""
    p = problem()
    exact = np.zeros(p.n_parameters)
    for k in range(p.n_parameters):
        for c in range(3):
            unit = np.zeros((p.n_parameters, 3), np.float32)
            unit[k, c] = 1
            exact[k] += p.normal(unit)[k, c] / 3
    found = diagonals(p, np.random.default_rng(0), probes=400, strain_probes=400).of(p)
    np.testing.assert_allclose(found, exact, rtol=0.3)
    assert found.mean() == pytest.approx(exact.mean(), rel=0.03)


def test_the_minimum_stays_the_same_field() -> None:
    plain = uneven()
    scaled = scaled_problem(plain)
    one, same = (p.field(solved(p, 400).x) for p in (plain, scaled))
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one, same, atol=2e-2 * np.abs(one).max())


def test_it_is_reached_in_fewer_steps() -> None:
    plain = uneven()
    scaled = scaled_problem(plain)
    end = scaled.field(solved(scaled, 400).x)
    far = [np.linalg.norm(p.field(solved(p, 12).x) - end) for p in (plain, scaled)]
    assert far[1] < 0.7 * far[0]


def test_a_torch_device_poses_the_same_problem() -> None:
    """Scaled ridge and scaled sampling both."""
    p = scaled_problem(problem(ridge=5.0))
    theta = np.random.default_rng(1).normal(size=(p.n_parameters, 3)).astype(np.float32)
    expected = p.normal(theta)
    found = DeviceProblem(p, "cpu").normal(torch.from_numpy(theta)).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_the_same_seed_scales_alike() -> None:
    one, same, other = (scaled_problem(problem(), k).damping for k in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
