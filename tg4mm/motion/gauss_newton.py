"""Motion of more than a pixel by Gauss-Newton: fit, move, look what is left, fit again.

A picture changes in proportion to motion as long as that is less than about a pixel, and the scene at rest was fitted
to a mean over time that larger motion blurs. So where the linear fit moves things by more than 0.7 pixels it
is repeated: every iteration renders what the motion found so far shows, fits the motion to what is left with Jacobians
where things have moved to, and then the scene at rest to all pictures (`refine.py`). An iteration counts only if the
new motion leaves less of the pictures than the old one; if not, half its step is tried, and if that does not
help either, that was all.

The Jacobians are taken at few states for all timesteps (`knots.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.checkpoints import Checkpoint, arrays_of, gaussians_of
from tg4mm.motion.config import MotionConfig, more_iterations
from tg4mm.motion.hyperparameters import Hyperparameters, chosen_weight, pixel_weights
from tg4mm.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.motion.knots import NuisancesAtRest, coupled_operator, knots_of, targets_at
from tg4mm.motion.nuisance.projection import Nuisance
from tg4mm.motion.observations import Observations
from tg4mm.motion.refine import refine_rest_scene
from tg4mm.motion.solver.operator import Fold
from tg4mm.motion.solver.pcg import pcg
from tg4mm.motion.solver.problem import Problem
from tg4mm.motion.split_half import LEAST, wiener_shrink
from tg4mm.motion.states import Errors, Evidence, states_moved
from tg4mm.motion.targets import TargetImages
from tg4mm.motion.temporal.synchronous import Synchronous
from tg4mm.progress import progress

ABOVE_PX = 0.7  # motion up to so many pixels is in the linear range
_FOR_WEIGHT = 6  # iterations for the candidate weights: what is left after an iteration tells less of them
_COMPONENTS = 8  # that are fitted, at least, where there are as many
_FALL = 0.05  # of the misfit: what falls by less is not worth another iteration


@dataclass(frozen=True)
class GaussNewtonState:
    """Where the iterations stand."""

    gaussians: Gaussians
    fields: np.ndarray  # [P, R, N, 6] of each fold
    smoothness_weight: float
    errors: Errors  # that they leave
    is_over: bool = False

    def arrays(self) -> dict[str, np.ndarray]:
        """For a checkpoint."""
        figures = self.smoothness_weight, self.errors.changes, self.errors.whole, float(self.is_over)
        return arrays_of(self.gaussians) | {"fields": self.fields, "figures": np.array(figures)}

    @staticmethod
    def restored(arrays: dict[str, np.ndarray]) -> GaussNewtonState:
        """From what `arrays` gave."""
        weight, changes, whole, is_over = (float(f) for f in arrays["figures"])
        errors = Errors(changes, whole)
        return GaussNewtonState(gaussians_of(arrays), arrays["fields"], weight, errors, bool(is_over))


def used_components(is_noise: np.ndarray) -> np.ndarray:
    """Which temporal components are fitted: those of the linear fit, and as many others and one, or eight in all.

    Pictures saturate where things move far, so that the first component is not quite what the motion does in time; the
    rest of that is in weaker ones. What is noise there after all fades by what the halves agree on; but what moves and
    is left out counts as noise of its pixels, which then say less.
    """
    linear, others = np.flatnonzero(~is_noise), np.flatnonzero(is_noise)
    return np.sort(np.concatenate([linear, others[: max(len(linear) + 1, _COMPONENTS - len(linear))]]))


class GaussNewton:
    """What all iterations share: pictures, components, folds, settings."""

    def __init__(
        self,
        observations: Observations,
        targets: TargetImages,
        hyper: Hyperparameters,
        folds: Sequence[Fold],
        nuisances: Sequence[Nuisance],
        config: MotionConfig,
        device: str,
    ) -> None:
        self.used = used_components(hyper.is_noise)
        self.basis, self.targets = targets.basis[self.used], targets
        self.linear = np.flatnonzero(~hyper.is_noise[self.used])
        self.weights = pixel_weights(targets, ~np.isin(np.arange(len(targets.basis)), self.used))
        self.observations, self.folds = observations, folds
        self.nuisances = NuisancesAtRest(nuisances, targets.mean)
        self.config, self.device, self.size = config, device, observations.size
        # all components together, linearised at several places: they settle more slowly
        self.iterations = config.iterations * 3 // 2
        width, height = self.size
        # as many as a quarter of the space stage's; few cameras alone would bend a scene that others saw, too
        enough = len(observations.frames) >= LEAST and observations.is_whole
        self.refining = int(np.clip(40 * (width * height / 4) ** (1 / 3), 250, 7_500)) if enough else 0

    def run(
        self,
        gaussians: Gaussians,
        views: Sequence[ViewJacobian],
        fields: np.ndarray,
        weight: float,
        checkpoint: Checkpoint,
    ) -> tuple[GaussNewtonState, list[float], Evidence]:
        """From the linear fit's fields [P, R', N, 6]: the last state, the misfit before and after each iteration."""
        start = np.zeros((len(fields), len(self.basis), *fields.shape[2:]), np.float32)
        start[:, self.linear] = fields
        agreed, _ = wiener_shrink(start)
        states, _ = states_moved(views, self.basis, agreed, self.size)
        evidence = Evidence.of(self.observations, states, self.targets, self.used)
        errors = evidence.remaining(gaussians, agreed, self.device)[1]
        state, misfits = GaussNewtonState(gaussians, start, weight, errors), [errors.changes]
        units = len(self.folds) * self.iterations * self._costs + self.refining
        with progress("Gauss-Newton", self.config.gauss_newton * units, "steps") as update:
            for k in range(self.config.gauss_newton):

                def tell(done: int, k: int = k, **figures: Any) -> None:
                    update(k * units + done, iteration=k + 1, **figures)

                before, compute = state, partial(self._iterated_arrays, state, evidence, k, tell)
                state = GaussNewtonState.restored(checkpoint(f"gauss_newton_{k}", compute))
                if state.errors.changes < before.errors.changes:
                    misfits.append(state.errors.changes)
                if state.is_over:
                    break
        return state, misfits, evidence

    @property
    def _costs(self) -> int:
        """Steps of refining that an iteration of conjugate gradients takes."""
        return max(2 * len(self.observations.frames) // len(self.folds), 1)

    def _iterated_arrays(
        self, state: GaussNewtonState, evidence: Evidence, k: int, tell: Callable[..., None]
    ) -> dict[str, np.ndarray]:
        return self._iterated(state, evidence, k, tell).arrays()

    def _iterated(
        self, state: GaussNewtonState, evidence: Evidence, k: int, tell: Callable[..., None]
    ) -> GaussNewtonState:
        """One iteration: its motion if it is accepted, then the scene at rest."""
        new, weight = self._fitted(state, evidence, tell)
        for length in (1.0, 0.5):
            stepped = (state.fields + np.float32(length) * (new - state.fields)).astype(np.float32)
            agreed, _ = wiener_shrink(stepped)
            errors = evidence.remaining(state.gaussians, agreed, self.device)[1]
            if errors.changes < state.errors.changes:
                gaussians, after = self._refined(state.gaussians, agreed, evidence, errors, k, tell)
                is_over = after.changes > (1 - _FALL) * state.errors.changes
                return GaussNewtonState(gaussians, stepped, weight, after, is_over)
        return replace(state, is_over=True)

    def _refined(
        self,
        gaussians: Gaussians,
        agreed: np.ndarray,
        evidence: Evidence,
        errors: Errors,
        k: int,
        tell: Callable[..., None],
    ) -> tuple[Gaussians, Errors]:
        """The scene at rest for this motion; the one before stays where it shows the pictures better."""
        if not self.refining:
            return gaussians, errors
        before = len(self.folds) * self.iterations * self._costs
        new = refine_rest_scene(
            gaussians, evidence.moved(agreed), self.refining, self.config.seed + k, self.device,
            lambda done: tell(before + done),
        )  # fmt: skip
        after = evidence.remaining(new, agreed, self.device)[1]
        return (new, after) if after.within(errors) else (gaussians, errors)

    def _fitted(
        self, state: GaussNewtonState, evidence: Evidence, tell: Callable[..., None]
    ) -> tuple[np.ndarray, float]:
        """[P, R, N, 6]: what each fold finds in this iteration; and the smoothness weight, chosen anew for it."""
        views = self.at_rest(state.gaussians)
        problem = Problem.of(views, state.gaussians, self.config, self.device)
        agreed, _ = wiener_shrink(state.fields)
        weight = state.smoothness_weight
        if not self.config.smoothness_weight and len(self.folds) == 2:
            at_rest = self.targets_at_rest(views, state.gaussians, agreed, evidence)
            target = np.stack([own[:1].copy() for own in at_rest])
            iterations = round(_FOR_WEIGHT * more_iterations(len(state.gaussians)))
            weight = chosen_weight(target, problem, self.folds, self.weights, iterations)
        knots = knots_of(state.gaussians, views, agreed, evidence, self.observations)
        left, _ = evidence.remaining(state.gaussians, agreed, self.device)
        found = []
        for p, fold in enumerate(self.folds):
            targets = targets_at(knots, fold, left, agreed, evidence)
            rest = problem.on_cpu(fold, self.weights, weight)
            operator, b = coupled_operator(problem, rest, knots, fold, self.nuisances, targets)
            done = p * self.iterations * self._costs
            update = partial(self._tell_solve, tell, done)
            solution = pcg(operator, b, self.iterations, self.config.tolerance, update=update)
            found.append(operator.fields(solution.theta))
        return np.stack(found), weight

    def _tell_solve(self, tell: Callable[..., None], before: int, done: int, residual: float) -> None:
        tell(before + done * self._costs, residual=round(residual, 4))

    def at_rest(self, gaussians: Gaussians) -> list[ViewJacobian]:
        """The views of all cameras."""
        return [view_jacobian(gaussians, camera, self.size) for camera in self.observations.frames]

    def targets_at_rest(
        self,
        views: Sequence[ViewJacobian],
        gaussians: Gaussians,
        agreed: np.ndarray,
        evidence: Evidence,
        some: Sequence[int] | None = None,
    ) -> Iterator[np.ndarray]:
        """[R, H, W, 3] of one view after the other, or of some: the target images that the motion explains at rest."""
        left, _ = evidence.remaining(gaussians, agreed, self.device)
        everything = np.arange(len(evidence.states.gains))
        rows = range(len(views)) if some is None else some
        return (evidence.target(v, left, everything, views[v].jvp(agreed)) for v in rows)


def iterated(
    model: Synchronous,
    hyper: Hyperparameters,
    folds: np.ndarray,
    judged: Sequence[int],
    checkpoint: Checkpoint,
) -> tuple[Synchronous, np.ndarray, Iterator[np.ndarray], dict[str, Any]]:
    """From the linear fit's fields [P, R', N, 6] on: the model with its scene at rest and functions of time as they are

    after the iterations, the folds' fields [P, R, N, 6], target images of the `judged` views, and figures for the log.
    """
    problem = model.problem
    loop = GaussNewton(
        model.observations, model.targets, hyper, model.folds, problem.nuisances, model.config, problem.device
    )
    weight = hyper.smoothness_weight
    state, misfits, evidence = loop.run(model.gaussians, problem.views, folds, weight, checkpoint)
    agreed, _ = wiener_shrink(state.fields)
    views = loop.at_rest(state.gaussians)
    images = loop.targets_at_rest(views, state.gaussians, agreed, evidence, judged)
    figures = {
        "gauss_newton": len(misfits) - 1,
        "misfits": misfits,
        "smoothness_weight": state.smoothness_weight,
    }
    problem = replace(problem, views=views, gaussians=state.gaussians, _kept={})
    return (
        replace(model, gaussians=state.gaussians, problem=problem, fitted=loop.used),
        state.fields,
        images,
        figures,
    )
