"""Motion of more than a pixel by Gauss-Newton: fit, move, render the residual, fit again.

A picture changes in proportion to motion as long as that is less than about a pixel, and the scene at rest was fitted
to a mean over time that larger motion blurs. So where the linear fit moves things by more than 0.7 pixels, or 0.35
with six cameras or more, it is repeated: every iteration renders what the motion found so far shows, fits the motion to
the residual with Jacobians where things have moved to, and then the scene at rest to all pictures (`refine.py`). An
iteration counts only if the residual of the pictures gets smaller; if not, half its step is tried, and if that does
not help, they are over. The Jacobians are taken at few states for all timesteps, the knots.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import moved
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, arrays_of, gaussians_of
from tg4mm.fit.motion.config import more_iterations
from tg4mm.fit.motion.hyperparameters import Hyperparameters, chosen_weight, pixel_weights
from tg4mm.fit.motion.jacobian.pixels import pixels_moved
from tg4mm.fit.motion.jacobian.view import VIEW_BYTES, ViewJacobian, view_jacobian
from tg4mm.fit.motion.nuisance.first_look import rest_views
from tg4mm.fit.motion.nuisance.projection import Nuisance, projections_of
from tg4mm.fit.motion.refine import refine_rest_scene
from tg4mm.fit.motion.solver.cuda import operator_on, views_on
from tg4mm.fit.motion.solver.operator import Array, Fold, Operator
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import LEAST, wiener_shrink
from tg4mm.fit.motion.states import Errors, StateObservations, most_states, states_of
from tg4mm.fit.motion.temporal import TemporalModel

KNOTS = 5  # at most: each costs as much as the problem at rest
KNOT_PX = 0.7  # states less apart share one


@dataclass(frozen=True)
class Knot:
    """States that share Jacobians."""

    views: list[ViewJacobian]  # of all cameras, where things are in these states
    states: np.ndarray  # rows of `StateObservations.states`
    mixing: np.ndarray  # C_l [ρ, R]


def knots_of(
    gaussians: Gaussians, views: Sequence[ViewJacobian], fields: np.ndarray, observed: StateObservations
) -> list[Knot]:
    """Knots of the motion `fields` [R, N, 6]; `views`: the Jacobians at rest."""
    states, motions = observed.states, observed.moved(fields).motions
    knots = states_of(states.gains.T, pixels_moved(views, fields[..., :3]), KNOTS, KNOT_PX)
    out = []
    for knot in range(len(knots.gains)):
        own = np.flatnonzero(knots.of == knot)
        share = states.count[own] / states.count[own].sum()
        motion = torch.from_numpy(np.tensordot(share, motions[own], 1).astype(np.float32))
        there = moved(gaussians, motion)
        is_large = len(knots.gains) * sum(view.nbytes for view in views) > VIEW_BYTES
        height, width = observed.pictures.shape[2:4]
        each = (view_jacobian(there, camera, (width, height)) for camera in observed.cameras)
        jacobians = [view.stored() if is_large else view for view in each]
        out.append(Knot(jacobians, own, _root(states.products[own].sum(0))))
    return out


def targets_at(
    knots: Sequence[Knot], fold: Fold, residuals: np.ndarray, fields: np.ndarray, observed: StateObservations
) -> Iterator[np.ndarray]:
    """C_lᵀ times the target images [R, H, W, 3] of each knot and view, one at a time: all are gigabytes at 1080p."""
    for knot in knots:
        for v in fold.views:
            shown = knot.views[v].jvp(fields)
            knot.views[v].release()
            yield observed.target_images(v, residuals, knot.states, shown)


def coupled_operator(
    problem: Problem,
    at_rest: Problem,
    knots: Sequence[Knot],
    fold: Fold,
    smoothness_weight: float,
    targets: Iterable[np.ndarray],
) -> tuple[Operator, Array]:
    """One fold with the views of all knots, and its right-hand sides.

    What is projected out is as in the problem `at_rest` of the linear fit.
    """
    rest = problem.on_cpu(fold, smoothness_weight)
    views, rows = [knot.views[v] for knot in knots for v in fold.views], [*fold.views] * len(knots)
    weights = None if rest.weights is None else np.concatenate([rest.weights] * len(knots))
    nuisances: list[Nuisance] = []
    if at_rest.nuisances:
        nuisances = [replace(at_rest.nuisances[v], view=own) for v, own in zip(rows, views, strict=True)]
    means = None if at_rest.means is None else [at_rest.means[v] for v in rows]
    projections = projections_of(nuisances, means, weights)
    plain = replace(rest, views=views, weights=weights, projections=projections)
    mixing = [knot.mixing for knot in knots for _ in fold.views]
    there = views_on(problem.device, views, problem.graph)
    b = operator_on(there, plain).right_hand_sides(targets)
    return operator_on(there, replace(plain, mixing=mixing)), b


def _root(products: np.ndarray) -> np.ndarray:
    """C [ρ, R] float32 with Cᵀ C = `products` [R, R]."""
    values, vectors = np.linalg.eigh(products)
    keep = values > 1e-9 * max(float(values[-1]), 1e-30)
    return (vectors[:, keep] * np.sqrt(values[keep])).T.astype(np.float32)


ABOVE_PX, MANY_CAMERAS_PX = 0.7, 0.35  # up to these motion is in the linear range
_FOR_WEIGHT = 6  # iterations for the candidate weights: the residual after an iteration tells less of them
_COMPONENTS = 8  # that are fitted, at least, where there are as many
_FALL = 0.05  # of the misfit: what falls by less is not worth another iteration


def linear_px(n_views: int) -> float:
    """Pixels from which on motion is iterated: few cameras do not tell where things lie, which costs more.

    Of a vibration of a pixels a texture of wavelength w shows 1 − (π a / w)² / 2: at w = 3 .73 of 0.7 px, .93 of 0.35.
    """
    return MANY_CAMERAS_PX if n_views >= LEAST else ABOVE_PX


@dataclass(frozen=True)
class GaussNewtonState:
    """What an iteration starts from."""

    gaussians: Gaussians
    fold_fields: np.ndarray  # [P, R, N, 6] of each fold
    smoothness_weight: float
    errors: Errors  # of the residual
    is_over: bool = False

    def arrays(self) -> Arrays:
        """For a checkpoint."""
        figures = self.smoothness_weight, self.errors.changes, self.errors.total, float(self.is_over)
        return arrays_of(self.gaussians) | {"fold_fields": self.fold_fields, "figures": np.array(figures)}

    @staticmethod
    def restored(arrays: Arrays) -> "GaussNewtonState":
        """From what `arrays` gave."""
        weight, changes, total, is_over = (float(f) for f in arrays["figures"])
        errors = Errors(changes, total)
        return GaussNewtonState(gaussians_of(arrays), arrays["fold_fields"], weight, errors, bool(is_over))


def used_components(is_noise: np.ndarray) -> np.ndarray:
    """Which temporal components are fitted: those of the linear fit, and as many others and one, or eight in all.

    Pictures saturate where things move far, so that the first component is not quite what the motion does in time; the
    rest of that is in weaker ones. What is noise there after all fades by its reliability; but what moves and
    is left out counts as noise of its pixels, which then say less.
    """
    linear, others = np.flatnonzero(~is_noise), np.flatnonzero(is_noise)
    return np.sort(np.concatenate([linear, others[: max(len(linear) + 1, _COMPONENTS - len(linear))]]))


class GaussNewton:
    """What all iterations share: pictures of states, components, folds, settings."""

    def __init__(self, model: TemporalModel, hyper: Hyperparameters, linear_fields: np.ndarray) -> None:
        """From the linear fit's fields [P, R', N, 6]."""
        self.used = used_components(hyper.is_noise)
        self.at_rest, self.targets, self.folds = model.problem, model.targets, model.folds
        self.basis, linear = self.targets.basis[self.used], np.flatnonzero(~hyper.is_noise[self.used])
        self.weights = pixel_weights(self.targets, ~np.isin(np.arange(len(self.targets.basis)), self.used))
        self.observations, self.config, self.device = model.observations, model.config, model.problem.device
        # all components together, linearised at several places: they settle more slowly
        self.iterations = self.config.iterations * 3 // 2
        width, height = self.observations.size
        # as many as a quarter of the space stage's; few cameras alone would bend a scene that others saw, too
        enough = len(self.observations.frames) >= LEAST and self.observations.is_whole
        self.refining = int(np.clip(40 * (width * height / 4) ** (1 / 3), 250, 7_500)) if enough else 0
        start = np.zeros((len(linear_fields), len(self.basis), *linear_fields.shape[2:]), np.float32)
        start[:, linear] = linear_fields
        fields, _ = wiener_shrink(start)
        views = self.at_rest.views
        moved, most = pixels_moved(views, fields[..., :3]), most_states(len(views), (width, height))
        states = states_of(self.basis, moved, most)
        self.observed = StateObservations.of(self.observations, states, self.targets, self.used)
        errors = self.observed.residuals(model.gaussians, fields, self.device)[1]
        self.start = GaussNewtonState(model.gaussians, start, hyper.smoothness_weight, errors)

    def run(self, checkpoint: Checkpoint) -> tuple[GaussNewtonState, list[float]]:
        """The last state, and the misfits along the way."""
        state, misfits = self.start, [self.start.errors.changes]
        units = len(self.folds) * self.iterations * self._costs + self.refining
        with progress("Gauss-Newton", self.config.gauss_newton * units, "steps") as update:
            for k in range(self.config.gauss_newton):

                def compute(state: GaussNewtonState = state, k: int = k) -> Arrays:
                    def tell(done: int, **figures: Any) -> None:
                        update(k * units + done, iteration=k + 1, **figures)

                    return self._iterated(state, k, tell).arrays()

                before, state = state, GaussNewtonState.restored(checkpoint(f"gauss_newton_{k}", compute))
                if state.errors.changes < before.errors.changes:
                    misfits.append(state.errors.changes)
                if state.is_over:
                    break
        return state, misfits

    @property
    def _costs(self) -> int:
        """Steps of refining that an iteration of conjugate gradients takes."""
        return max(2 * len(self.observations.frames) // len(self.folds), 1)

    def _iterated(self, state: GaussNewtonState, k: int, tell: Callable[..., None]) -> GaussNewtonState:
        """One iteration: its motion if it is accepted, then the scene at rest."""
        new, weight = self._solved(state, tell)
        for length in (1.0, 0.5):
            stepped = (state.fold_fields + np.float32(length) * (new - state.fold_fields)).astype(np.float32)
            fields, _ = wiener_shrink(stepped)
            errors = self.observed.residuals(state.gaussians, fields, self.device)[1]
            if errors.changes < state.errors.changes:
                gaussians, after = self._refined(state.gaussians, fields, errors, k, tell)
                is_over = after.changes > (1 - _FALL) * state.errors.changes
                return GaussNewtonState(gaussians, stepped, weight, after, is_over)
        return replace(state, is_over=True)

    def _refined(
        self, gaussians: Gaussians, fields: np.ndarray, errors: Errors, k: int, tell: Callable[..., None]
    ) -> tuple[Gaussians, Errors]:
        """The scene at rest for this motion; the one before stays where it shows the pictures better."""
        if not self.refining:
            return gaussians, errors
        before = len(self.folds) * self.iterations * self._costs
        new = refine_rest_scene(
            gaussians, self.observed.moved(fields), self.refining, self.config.seed + k, self.device,
            lambda done: tell(before + done),
        )  # fmt: skip
        after = self.observed.residuals(new, fields, self.device)[1]
        return (new, after) if after.is_no_larger(errors) else (gaussians, errors)

    def _solved(self, state: GaussNewtonState, tell: Callable[..., None]) -> tuple[np.ndarray, float]:
        """[P, R, N, 6]: what each fold finds in this iteration; and the smoothness weight, chosen anew for it."""
        views = rest_views(state.gaussians, self.observations)
        problem = Problem.of(views, state.gaussians, self.config, self.device)
        problem = problem.changed(pixel_weights=self.weights)
        fields, _ = wiener_shrink(state.fold_fields)
        weight = state.smoothness_weight
        residuals, _ = self.observed.residuals(state.gaussians, fields, self.device)
        if not self.config.smoothness_weight and len(self.folds) == 2:
            images = self.rest_targets(residuals, views, fields, range(len(views)))
            target = np.stack([own[:1].copy() for own in images])
            iterations = round(_FOR_WEIGHT * more_iterations(len(state.gaussians)))
            weight = chosen_weight(target, problem, self.folds, iterations)
        knots = knots_of(state.gaussians, views, fields, self.observed)
        solved = []
        for p, fold in enumerate(self.folds):
            targets = targets_at(knots, fold, residuals, fields, self.observed)
            operator, b = coupled_operator(problem, self.at_rest, knots, fold, weight, targets)

            def update(done: int, residual: float, p: int = p) -> None:
                tell((p * self.iterations + done) * self._costs, residual=round(residual, 4))

            solution = pcg(operator, b, self.iterations, self.config.tolerance, update=update)
            solved.append(operator.fields(solution.theta))
        return np.stack(solved), weight

    def rest_targets(
        self, residuals: np.ndarray, views: Sequence[ViewJacobian], fields: np.ndarray, rows: Iterable[int]
    ) -> Iterator[np.ndarray]:
        """[R, H, W, 3] of some of the `views` at rest: the target images of fields [R, N, 6] and what they leave."""
        states = np.arange(len(self.observed.states.gains))
        return (self.observed.target_images(v, residuals, states, views[v].jvp(fields)) for v in rows)


def gauss_newton(
    model: TemporalModel,
    hyper: Hyperparameters,
    folds: np.ndarray,
    judged: Sequence[int],
    checkpoint: Checkpoint,
) -> tuple[TemporalModel, np.ndarray, Iterator[np.ndarray], dict[str, Any]]:
    """From the linear fit's fields [P, R', N, 6] on.

    Gives the model with its scene at rest and functions of time after the iterations, the folds' fields [P, R, N, 6],
    target images of the `judged` views, and figures for the log.
    """
    loop, problem = GaussNewton(model, hyper, folds), model.problem
    state, misfits = loop.run(checkpoint)
    fields, _ = wiener_shrink(state.fold_fields)
    views = rest_views(state.gaussians, model.observations)
    residuals, _ = loop.observed.residuals(state.gaussians, fields, problem.device)
    images = loop.rest_targets(residuals, views, fields, judged)
    figures = {
        "gauss_newton": len(misfits) - 1,
        "misfits": misfits,
        "smoothness_weight": state.smoothness_weight,
    }
    problem = problem.changed(views=views, gaussians=state.gaussians)
    model = replace(model, gaussians=state.gaussians, problem=problem, fitted=loop.used)
    return model, state.fold_fields, images, figures
