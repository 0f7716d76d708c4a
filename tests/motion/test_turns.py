"""The linear fit's two turns: together one solution, of the pictures less what is taken away between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.motion.test_problem import N, problem
from tg4mm.motion import fit as module
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.fit import Fit, Solver
from tg4mm.motion.solver.pcg import CGState, start, step, step_all
from tg4mm.motion.solver.problem import MotionProblem

PARTS = [np.array([0]), np.array([1])]
LONG = MotionConfig(iterations=300, tolerance=1e-6)


def pictures(seed: int) -> np.ndarray:
    """Three components of two cameras."""
    shape = (2, 3, *problem().views[0].transmittance.shape, 3)
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def solver(images: np.ndarray, config: MotionConfig = LONG) -> Solver:
    whole = problem()
    return Solver([whole.of_views(p) for p in PARTS], PARTS, images, np.array([0, 2]), config, "cpu")


def both_turns(solving: Solver, taken: np.ndarray | None = None) -> Fit:
    fit = Fit.begun(solving.n_fields, N)
    solving.run(fit, lambda *_, **__: None, lambda _: None)
    fit.turn, fit.component = 1, 0
    for part, rows in enumerate(PARTS):
        if taken is not None:
            of_part = taken[rows][:, solving.signal]
            solving.take_away(fit, part, lambda some, of_part=of_part: (p[some] for p in of_part))
    solving.run(fit, lambda *_, **__: None, lambda _: None)
    return fit


def count_applications(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Gets, from now on, how many fields each call of the operator takes."""
    applied: list[int] = []
    real = MotionProblem.normals

    def counted(self: MotionProblem, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        applied.append(len(thetas))
        return real(self, thetas)

    monkeypatch.setattr(MotionProblem, "normals", counted)
    return applied


def direct(images: np.ndarray) -> np.ndarray:
    out, whole = [], problem()
    for rows in PARTS:
        part = whole.of_views(rows)
        states = [start(b) for b in part.right_hand_sides(images[rows][:, [0, 2]])]
        while max(s.relative_residual for s in states) > 1e-6:
            states = step_all(states, part.normals)
        out += [part.field(s.x) for s in states]
    return np.stack(out)


@pytest.mark.parametrize("together", [1, 8])
@pytest.mark.parametrize("takes", [False, True])
def test_they_end_where_one_fit_of_what_is_left_would(
    takes: bool, together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TOGETHER", together)
    images, taken = pictures(1), 0.3 * pictures(2)
    found = both_turns(solver(images), taken if takes else None).shapes
    expected = direct(images - taken if takes else images)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def begun(solving: Solver, iterations: int) -> CGState:
    """The strongest component of the first part, so far."""
    part = solving.problems[0]
    (state,) = [start(b) for b in part.right_hand_sides(solving.images[PARTS[0]][:, :1])]
    for _ in range(iterations):
        state = step(state, part.normal)
    return state


@pytest.mark.parametrize(
    ("iterations", "saved"), [(3, 3), (6, 6), (7, 0)], ids=["fewer", "all of a turn", "too many"]
)
def test_what_has_been_begun_is_gone_on_with(
    iterations: int, saved: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    applied = count_applications(monkeypatch)
    solving = solver(pictures(1), MotionConfig(iterations=20, tolerance=1e-6))
    assert solving.iterations(0) == 6
    expected = both_turns(solving).shapes
    plain = sum(applied)
    known = replace(solving, begun=begun(solving, iterations))
    applied.clear()
    assert np.array_equal(both_turns(known).shapes, expected)
    assert sum(applied) == plain - saved


@pytest.mark.parametrize("iterations", [1, 2, 5, 20])
def test_they_take_the_iterations_of_one_fit(iterations: int, monkeypatch: pytest.MonkeyPatch) -> None:
    applied = count_applications(monkeypatch)
    solving = solver(pictures(1), MotionConfig(iterations=iterations, tolerance=1e-6))
    fit = both_turns(solving)
    assert sum(applied) == solving.units == 4 * iterations
    assert solving.done(fit) == solving.units
