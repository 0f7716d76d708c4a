"""Appearance: what motion leaves of the target images, as changes of the Gaussians' colour.

Two folds of the cameras are fitted, as for the motion, and their mean is multiplied by its reliability around each
Gaussian: gloss and shadows change in places. A component whose reliability is less than a half altogether holds noise,
or no appearance, and is dropped, after one iteration if it shows by then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.core.memory import release
from tg4mm.fit.motion.appearance_problem import HARMONIC, AppearanceProblem, appearance_views
from tg4mm.fit.motion.jacobian.view import PosedView
from tg4mm.fit.motion.linear_fit import Correction
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import mean_over_neighbours, reliability

ITERATIONS = 3  # six do hardly better
LOOK = 1  # iterations after which it is told whether the folds agree; enough between the motion's two passes
_MIN_RELIABILITY = 0.5  # below it a component has none
_TOGETHER = 8  # components that share a pass over the views


@dataclass(frozen=True)
class MotionResidual:
    """What motion leaves of target images, of R components."""

    problem: Problem
    pictures: np.ndarray  # [V, …, H, W, 3]
    rows: np.ndarray  # [R] which of the components
    fields: np.ndarray  # [R, N, 6], their motion

    def of(self, fold: Fold, some: np.ndarray) -> Iterator[np.ndarray]:
        """[s, H, W, 3] of each view of a fold, for `some` of the R components."""
        for v in fold.views:
            targets = self.pictures[v, self.rows[some]]
            yield self.problem.residual(v, targets, self.fields[some])
            release(self.pictures)


@dataclass(frozen=True)
class AppearanceFit:
    """The search for changes of colour with two folds of the cameras."""

    problem: AppearanceProblem
    folds: Sequence[Fold]
    knn: np.ndarray  # [N, count], the nearest Gaussians of each

    @staticmethod
    def of(motion: Problem, cameras: Sequence[PosedView], folds: Sequence[Fold]) -> AppearanceFit:
        """Beside a motion problem; folds: two of the cameras."""
        tilts = motion.gaussians.sh_degree > 0
        own = appearance_views(motion.views, cameras, motion.gaussians.means.numpy(), tilts)
        return AppearanceFit(
            AppearanceProblem.of(own, motion.pixel_weights, motion.graph), folds, motion.graph.knn
        )

    def between_passes(self, residual: MotionResidual) -> Correction | None:
        """For `LinearFit.second_pass`, by one iteration; None where there is no appearance."""
        changes, _ = self.fitted(residual, None, LOOK)
        if not changes.any():
            return None
        return lambda p, fields, some: (self.shown(int(v), changes[some]) for v in self.folds[p].views)

    def fitted(
        self,
        residual: MotionResidual,
        update: Callable[[int], None] | None = None,
        iterations: int = ITERATIONS,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the first coefficients of spherical harmonics [R, N, K, 3] float32, and gains [R].

        A component that is dropped has gain and change 0. `update` is called with how many are done.
        """
        problems = [self.problem.of_views(fold.views) for fold in self.folds]
        changes = np.zeros((len(residual.rows), *self.problem.root.shape[:2], 3), np.float32)
        gains = np.zeros(len(changes), np.float32)
        for first in range(0, len(changes), _TOGETHER):
            some = np.arange(first, min(first + _TOGETHER, len(changes)))
            sides = [
                problem.right_hand_sides(residual.of(fold, some))
                for problem, fold in zip(problems, self.folds, strict=True)
            ]
            x, gains[some] = shared_appearance(problems, sides, self.knn, iterations)
            changes[some] = x / np.float32(HARMONIC)
            if update is not None:
                update(first + len(some))
        return changes, gains

    def shown(self, v: int, changes: np.ndarray) -> np.ndarray:
        """[R, H, W, 3]: the pictures in view `v` of changes [R, N, K, 3]; until the next call."""
        return self.problem.views[v].jvp(changes * np.float32(HARMONIC), self.problem.buffers)


def shared_appearance(
    problems: Sequence[AppearanceProblem],
    sides: Sequence[np.ndarray],
    knn: np.ndarray,
    iterations: int = ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of colour [R, N, K, 3] and gains [R] from the problems of two folds and R right-hand sides of each."""
    changes, gains = np.zeros_like(sides[0]), np.zeros(len(sides[0]), np.float32)
    going = np.arange(len(changes))
    for count in sorted({LOOK, iterations}):
        a, b = (
            problem.colours(pcg(problem, own[going], count, 0.0).theta)
            for problem, own in zip(problems, sides, strict=True)
        )
        mean = (a + b) / 2
        gain = reliability(*(v.reshape(*v.shape[:2], -1) for v in (mean, a, b)))
        good = gain >= _MIN_RELIABILITY
        going = going[good]
        if not len(going):
            return changes, gains
    mean, a, b = (v[good] for v in (mean, a, b))
    changes[going] = mean * _local_reliability(mean, a, b, knn)[..., None, None]
    gains[going] = gain[good]
    return changes, gains


def _local_reliability(mean: np.ndarray, a: np.ndarray, b: np.ndarray, knn: np.ndarray) -> np.ndarray:
    """[R, N] float32, 0 to 1: `reliability` over the nearest Gaussians of each, of components [R, N, K, 3]."""
    both, power = (np.einsum("rnkc,rnkc->nr", *pair) for pair in ((a, b), (mean, mean)))
    both, power = np.split(mean_over_neighbours(np.concatenate([both, power], 1), knn).T, 2)
    return np.clip(both / np.maximum(power, np.finfo(np.float32).tiny), 0, 1)
