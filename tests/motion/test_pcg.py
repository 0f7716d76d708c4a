"""Conjugate gradients: they solve, they stop, and they go on where they were."""

from __future__ import annotations

import numpy as np
import pytest

from tg4mm.motion.solver.pcg import CGState, start, step, step_all


def system(n: int = 12, dtype: type = np.float64, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A symmetric positive matrix of condition 50 and a right-hand side [n, 3]."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    A = (q * np.linspace(1, 50, n)) @ q.T
    return A.astype(dtype), rng.normal(size=(n, 3)).astype(dtype)


def solved(A: np.ndarray, b: np.ndarray, steps: int) -> CGState:
    state = start(b)
    for _ in range(steps):
        state = step(state, lambda x: A @ x)
    return state


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-10), (np.float32, 2e-4)])
def test_a_random_system_is_solved(dtype: type, tolerance: float) -> None:
    A, b = system(dtype=dtype)
    state = solved(A, b, 40)
    exact = np.linalg.solve(A.astype(float), b.astype(float))
    assert np.abs(state.x - exact).max() < tolerance
    assert state.relative_residual < tolerance
    assert state.x.dtype == state.residual.dtype == state.direction.dtype == dtype
    assert np.abs(solved(A, b, 3).x - exact).max() > 10 * tolerance


def test_the_unknowns_are_one_vector_whatever_their_shape() -> None:
    """Three right-hand sides side by side are one problem of 36 unknowns: exact after 36 steps, all but rounding."""
    A, b = system()
    state = solved(np.kron(A, np.eye(3)), b.reshape(-1, 1), 25)
    np.testing.assert_allclose(solved(A, b, 25).x.reshape(-1, 1), state.x, rtol=1e-6, atol=1e-9)


def test_the_residual_is_b_minus_a_x() -> None:
    A, b = system()
    state = solved(A, b, 5)
    np.testing.assert_allclose(state.residual, b - A @ state.x, atol=1e-12)
    expected = np.linalg.norm(b - A @ state.x) / np.linalg.norm(b)
    assert state.relative_residual == pytest.approx(expected, rel=1e-10)
    assert state.iteration == 5


def test_directions_are_conjugate_and_the_energy_falls() -> None:
    A, b = system()
    state, directions, energies = start(b), [], []
    for _ in range(8):
        directions.append(state.direction)
        state = step(state, lambda x: A @ x)
        energies.append(float((state.x * (A @ state.x)).sum() / 2 - (state.x * b).sum()))
    gram = np.array([[(p * (A @ q)).sum() for q in directions] for p in directions])
    scale = np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    assert np.abs(gram / scale - np.eye(8)).max() < 1e-8
    assert (np.diff(energies) < 0).all()


def test_it_resumes_to_the_bit() -> None:
    A, b = system(dtype=np.float32)
    state = solved(A, b, 4)
    copy = CGState(
        state.x.copy(), state.residual.copy(), state.direction.copy(), state.initial, state.iteration
    )
    for _ in range(5):
        copy = step(copy, lambda x: A @ x)
    expected = solved(A, b, 9)
    for name in ("x", "residual", "direction"):
        np.testing.assert_array_equal(getattr(copy, name), getattr(expected, name))
    assert copy.iteration == 9


def test_several_systems_step_as_they_would_alone() -> None:
    """To the bit; an exact one is left out of what the operator is asked."""
    A, b = system(dtype=np.float32)
    states, asked = [start(b), start(np.zeros_like(b)), start(2 * b[::-1].copy())], []

    def operator(directions):
        asked.append(len(directions))
        return [A @ d for d in directions]

    for _ in range(4):
        states = step_all(states, operator)
    assert asked == [2] * 4
    for state, alone in zip(
        states, (solved(A, b, 4), start(0 * b), solved(A, 2 * b[::-1].copy(), 4)), strict=True
    ):
        np.testing.assert_array_equal(state.x, alone.x)
        assert state.iteration == alone.iteration


def test_nothing_asked_is_solved_at_once() -> None:
    state = start(np.zeros((4, 3), np.float32))
    assert state.relative_residual == 0
    assert step(state, lambda x: 1 / x) is state


def test_states_are_not_changed_by_a_step() -> None:
    A, b = system()
    state = solved(A, b, 2)
    before = state.x.copy(), state.residual.copy(), b.copy()
    step(state, lambda x: A @ x)
    for was, now in zip(before, (state.x, state.residual, b), strict=True):
        np.testing.assert_array_equal(was, now)
