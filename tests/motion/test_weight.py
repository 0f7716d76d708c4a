"""The neighbour term's weight by cross-validation: noise asks for more of it, parts that move apart for less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.motion.test_view_jacobian import gaussians_of, view_of
from tests.rasterize.oracle import make_scene
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.posing.pose import Problems
from tg4mm.motion.posing.weight import CANDIDATES, DEFAULT, chosen_weight
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.pcg import start, step
from tg4mm.motion.solver.problem import MotionProblem, normals_of

N, CAMERAS = 80, 8
PARTS = [np.arange(CAMERAS)[::2], np.arange(CAMERAS)[1::2]]


def made(weights: Sequence[float]) -> list[MotionProblem]:
    """One problem for each weight of the neighbours; eight cameras look at one cloud."""
    scene = make_scene(1, n=N, cameras=CAMERAS)
    views = [
        view_of(replace(scene, viewmats=scene.viewmats[c : c + 1], Ks=scene.Ks[c : c + 1]))
        for c in range(CAMERAS)
    ]
    problems = Problems(views, gaussians_of(scene), MotionConfig(), "cpu").of(None, weights)
    return [p for p in problems if isinstance(p, MotionProblem)]


@pytest.fixture(scope="module")
def posed() -> list[MotionProblem]:
    return made(CANDIDATES)


def moved(u: np.ndarray) -> np.ndarray:
    """Displacements [N, 3] without rotation, [N, DOF]."""
    return np.concatenate([u, np.zeros((len(u), DOF - 3))], 1).astype(np.float32)


def shown(p: MotionProblem, u: np.ndarray, noise: float) -> np.ndarray:
    """Component images of a displacement, with noise as a share of their rms."""
    pictures = np.stack([view.jvp(moved(u)[None])[0] for view in p.views])
    spread = noise * np.sqrt((pictures**2).mean())
    return (pictures + np.random.default_rng(2).normal(0, spread, pictures.shape)).astype(np.float32)


def each_by_itself() -> np.ndarray:
    return np.random.default_rng(1).normal(size=(N, 3)).astype(np.float32)


def as_one() -> np.ndarray:
    return np.tile(np.float32([1, -0.5, 0.3]), (N, 1))


def test_what_moves_each_by_itself_is_hardly_held_together(posed: list[MotionProblem]) -> None:
    assert chosen_weight(posed, PARTS, shown(posed[0], each_by_itself(), 0.0))[0] == CANDIDATES[0]


def test_noise_asks_for_more_of_it(posed: list[MotionProblem]) -> None:
    """All move nearly as one; no noise, and ten times the pictures' rms."""
    u = as_one() + 0.3 * each_by_itself()
    little, much = (chosen_weight(posed, PARTS, shown(posed[0], u, noise))[0] for noise in (0.0, 10.0))
    assert much > 10 * little


def test_what_was_solved_for_on_the_way_is_the_fit_as_far_as_it_came(posed: list[MotionProblem]) -> None:
    pictures = shown(posed[0], as_one() + 0.3 * each_by_itself(), 0.1)
    weight, begun = chosen_weight(posed, PARTS, pictures)
    whole = next(p for p in posed if p.config.neighbours == weight)
    assert begun is not None
    problem = whole.of_views(PARTS[0])
    plain = start(problem.right_hand_side(pictures[PARTS[0]]))
    for _ in range(begun.iteration):
        plain = step(plain, problem.normal)
    assert begun.iteration > 2
    for name in ("x", "residual", "direction"):
        assert np.array_equal(getattr(begun, name), getattr(plain, name)), name


def test_a_fit_that_would_have_ended_on_the_way_is_not_gone_on_with(posed: list[MotionProblem]) -> None:
    pictures = shown(posed[0], as_one() + 0.3 * each_by_itself(), 0.1)
    easy = [replace(p, config=replace(p.config, tolerance=0.5)) for p in posed]
    assert chosen_weight(easy, PARTS, pictures) == (chosen_weight(posed, PARTS, pictures)[0], None)


def test_the_same_on_a_torch_device(posed: list[MotionProblem]) -> None:
    first = DeviceProblem(posed[0], "cpu")
    there = [first, *(first.posed_as(p) for p in posed[1:])]
    for u, noise in ((each_by_itself(), 0.0), (as_one(), 10.0)):
        pictures = shown(posed[0], u, noise)
        assert chosen_weight(there, PARTS, pictures)[0] == chosen_weight(posed, PARTS, pictures)[0]


def test_pictures_that_do_not_change_say_nothing(posed: list[MotionProblem]) -> None:
    still = np.zeros_like(shown(posed[0], as_one(), 0.0))
    assert chosen_weight(posed, PARTS, still) == (DEFAULT, None)


@pytest.mark.parametrize("still", [0, 1])
def test_one_half_that_does_not_change_says_nothing(posed: list[MotionProblem], still: int) -> None:
    pictures = shown(posed[0], as_one(), 0.0)
    pictures[PARTS[still]] = 0
    assert chosen_weight(posed, PARTS, pictures) == (DEFAULT, None)


def test_the_other_half_is_the_judge(posed: list[MotionProblem]) -> None:
    """The first half shows a motion of each by itself; it is held back where the second shows the opposite."""
    pictures = shown(posed[0], each_by_itself(), 0.0)
    believed = chosen_weight(posed, PARTS, pictures)[0]
    pictures[PARTS[1]] *= -1
    assert chosen_weight(posed, PARTS, pictures)[0] > 10 * believed


def test_several_problems_in_one_pass_are_each_by_itself(posed: list[MotionProblem]) -> None:
    rng = np.random.default_rng(4)
    thetas = [rng.normal(size=(p.n_parameters, 3)).astype(np.float32) for p in posed]
    for p, theta, found in zip(posed, thetas, normals_of(posed, thetas), strict=True):
        expected = p.normal(theta)
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_the_misfit_is_what_a_field_leaves_unexplained(posed: list[MotionProblem]) -> None:
    p, pictures = posed[0], shown(posed[0], as_one(), 0.5)
    fields = [moved(f * as_one()) for f in (0.0, 1.0)]
    left = [pictures - np.stack([v.jvp(f[None])[0] for v in p.views]) for f in fields]
    expected = [float((x.astype(np.float64) ** 2).sum()) for x in left]
    np.testing.assert_allclose(p.misfits(fields, pictures), expected, rtol=1e-4)
    assert expected[1] < expected[0]
