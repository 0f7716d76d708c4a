"""Motion of more than a pixel before several cameras: fit, move, render the residual, fit again (Gauss–Newton).

Where the linear fit moves things by more than 0.7 pixels, or 0.35 with six cameras or more, it is repeated: every
iteration renders the motion found so far, fits the motion to the residual with Jacobians at the moved positions, and
then the scene at rest to all pictures (`refine.py`). An iteration counts only if the residual of the pictures falls;
if not, half its step is tried. The Jacobians are taken at a few states for all timesteps, the linearisation points.

States. A vibration passes the same few positions over and over. Timesteps between which nothing moves by more than a
fraction of a pixel are one state, whose picture is the mean of theirs: the cost of an iteration grows with states
instead of timesteps, and noise is averaged. A smaller mode beside a large one is averaged out of all states. What it
changes in the pictures remains as target images, less their part in the states' pictures, and is small enough to be
explained linearly: from the capture in each iteration, not from the last result, which would be smoothed again.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from scipy.cluster.hierarchy import fcluster, linkage

from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import moved
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, arrays_of, gaussians_of
from tg4mm.fit.motion.hyperparameters import Hyperparameters, chosen_weight, pixel_weights
from tg4mm.fit.motion.jacobian.view import VIEW_BYTES, ViewJacobian, pixels_moved, view_jacobian
from tg4mm.fit.motion.large import iterated
from tg4mm.fit.motion.nuisance.fixed_cameras import rest_views
from tg4mm.fit.motion.nuisance.projection import Nuisance, projections_of
from tg4mm.fit.motion.observations import Observations, PosedFrames, strips
from tg4mm.fit.motion.refine import MovedPictures, refine_rest_scene
from tg4mm.fit.motion.solver.cuda import operator_on, views_on
from tg4mm.fit.motion.solver.operator import Array, Fold, Operator
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import LEAST, wiener_shrink
from tg4mm.fit.motion.targets import TargetImages
from tg4mm.fit.motion.temporal import TemporalModel
from tg4mm.fit.space.view import render_view

STATE_PX = 0.1  # timesteps between which nothing moves by more are one state
MOST = 24  # states, and fewer where their pictures would take more than
PICTURE_BYTES = 1 << 30
POINTS = 5  # at most: each costs as much as the problem at rest
POINT_PX = 0.7  # states less apart share one
_ROWS = 64  # of a picture at a time, where pictures are combined
ABOVE_PX, MANY_CAMERAS_PX = 0.7, 0.35  # up to these motion is in the linear range
_FOR_WEIGHT = 6  # iterations for the candidate weights: the residual after an iteration says less about them
_COMPONENTS = 8  # that are fitted, at least, where there are as many


@dataclass(frozen=True)
class States:
    """K states of T timesteps."""

    of: np.ndarray  # [T] 0 … K − 1
    gains: np.ndarray  # [K, R] float64, mean of a_r(t) over each state's timesteps
    products: np.ndarray  # [K, R, R] float64, sum of a(t) a(t)ᵀ over them: changes within a state count, too

    @property
    def count(self) -> np.ndarray:
        """Return [K] float64, timesteps of each state."""
        return np.bincount(self.of, minlength=len(self.gains)).astype(np.float64)

    @property
    def sums(self) -> np.ndarray:
        """Return [K, R] float64, sum of a_r(t) over each state's timesteps."""
        return self.gains * self.count[:, None]


def states_of(
    basis: np.ndarray, pixels: np.ndarray, most: int = MOST, diameter_px: float = STATE_PX
) -> States:
    """Return at most `most` states of functions of time [R, T], each worth so many `pixels` [R] of motion.

    `diameter_px`: what moves at most between timesteps of one state, unless there would be more states than that.
    """
    places = basis.T * pixels
    if len(places) < 2:
        labels = np.zeros(len(places), np.int64)
    else:
        tree = linkage(places, "complete")
        labels = fcluster(tree, diameter_px, "distance")
        if labels.max() > most:
            labels = fcluster(tree, most, "maxclust")
        labels = np.unique(labels, return_inverse=True)[1]
    count = np.bincount(labels)
    sums = np.zeros((len(count), len(basis)))
    np.add.at(sums, labels, basis.T)
    products = np.zeros((len(count), len(basis), len(basis)))
    np.add.at(products, labels, np.einsum("rt,qt->trq", basis, basis))
    return States(labels, sums / count[:, None], products)


def most_states(n_views: int, size: tuple[int, int]) -> int:
    """Return the number of states, 3 to `MOST`, whose pictures of `n_views` cameras fit in `PICTURE_BYTES`."""
    return int(np.clip(PICTURE_BYTES // (12 * n_views * size[0] * size[1]), 3, MOST))


def state_pictures(observations: Observations, states: States) -> np.ndarray:
    """Return [V, K, H, W, 3] float32 (`mapped_zeros`): mean over the timesteps of each state, by camera, over white."""
    width, height = observations.size
    share = np.zeros((len(states.gains), len(states.of)), np.float32)
    share[states.of, np.arange(len(states.of))] = 1 / states.count[states.of]
    out = mapped_zeros((len(observations.frames), len(states.gains), height, width, 3))
    for v, frames in enumerate(observations.frames):
        for rows, strip in strips(observations.pictures, frames):
            flat = share @ strip.reshape(len(strip), -1)
            out[v, :, rows] = flat.reshape(len(flat), *strip.shape[1:])
        release(out)
    return out


@dataclass(frozen=True)
class Errors:
    """Σ over timesteps, pixels and channels of squared differences of states' pictures."""

    changes: float  # each picture less its mean over time, which holds what stands still
    total: float

    def is_no_larger(self, other: "Errors") -> bool:
        """Return whether neither sum is larger."""
        return self.changes <= other.changes and self.total <= other.total


@dataclass(frozen=True)
class StateObservations:
    """The pictures of K states and R components in V synchronous cameras."""

    cameras: list[PosedFrames]
    states: States
    pictures: np.ndarray  # [V, K, H, W, 3] float32 over white
    changes_within: np.ndarray  # [V, R, H, W, 3] float32: target images of the changes within states

    @staticmethod
    def of(
        observations: Observations, states: States, targets: TargetImages, used: np.ndarray
    ) -> "StateObservations":
        """`used` [R]: which of the target images belong to the functions of time of `states`."""
        pictures = state_pictures(observations, states)
        changes_within = mapped_zeros((len(pictures), len(used), *pictures.shape[2:]))
        for v, seen in enumerate(pictures):
            changes_within[v] = targets.of(v, used)
            _add(changes_within[v], -states.sums.T, seen)
            release(changes_within)
            release(pictures)
        return StateObservations(observations.frames, states, pictures, changes_within)

    def moved(self, fields: np.ndarray) -> MovedPictures:
        """Return the pictures with the motion of fields [R, N, 6]."""
        motions = np.tensordot(self.states.gains, fields, 1).astype(np.float32)
        return MovedPictures(self.cameras, self.pictures, motions, self.states.of)

    def residuals(self, gaussians: Gaussians, fields: np.ndarray, device: str) -> tuple[np.ndarray, Errors]:
        """Return pictures less the rendered ones, each less its mean over time, [V, K, H, W, 3], and their squares."""
        out = rendered(gaussians, self.moved(fields), device)
        share = (self.states.count / self.states.count.sum()).astype(np.float32)
        total = changes = 0.0
        for of_camera, seen in zip(out, self.pictures, strict=True):
            np.subtract(seen, of_camera, out=of_camera)
            total += self._squares(of_camera)
            of_camera -= np.tensordot(share, of_camera, 1)
            changes += self._squares(of_camera)
            release(out)
            release(self.pictures)
        return out, Errors(changes, total)

    def _squares(self, of_camera: np.ndarray) -> float:
        squares = [float(np.einsum("hwc,hwc->", s, s, dtype=np.float64)) for s in of_camera]
        return float(squares @ self.states.count)

    def target_images(self, v: int, residuals: np.ndarray, rows: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """Return [R, H, W, 3]: camera v's target images that the motion explains, at the states `own` linearised there.

        residuals: of `residuals`. shown [R, H, W, 3]: what the motion found so far changes there, for gains of 1. What
        changes within states is taken as spread evenly over time.
        """
        sums = self.states.sums[rows]
        mix = (sums.T @ self.states.gains[rows]).astype(np.float32)
        share = np.float32(self.states.count[rows].sum() / self.states.count.sum())
        changes = np.asarray(share * self.changes_within[v])
        mixed = np.zeros((sums.shape[1], len(residuals[v])))
        mixed[:, rows] = sums.T
        _add(changes, mixed, residuals[v])
        _add(changes, mix, shown)
        release(self.changes_within)
        release(residuals)
        return changes


def _add(images: np.ndarray, matrix: np.ndarray, pictures: np.ndarray) -> None:
    """Add matrix [R, K] times pictures [K, H, W, 3] to images [R, H, W, 3], some rows at a time."""
    matrix = matrix.astype(np.float32)
    for top in range(0, images.shape[1], _ROWS):
        rows = slice(top, top + _ROWS)
        images[:, rows] += np.tensordot(matrix, pictures[:, rows], 1)


@torch.no_grad()
def rendered(gaussians: Gaussians, seen: MovedPictures, device: str) -> np.ndarray:
    """Render the Gaussians moved to every state, over white: [V, K, H, W, 3] float32 (`mapped_zeros`)."""
    height, width = seen.pictures.shape[2:4]
    there, out = gaussians.to(device), mapped_zeros(seen.pictures.shape)
    cameras = [[torch.from_numpy(a).to(device) for a in (c.viewmat, c.K)] for c in seen.cameras]
    for k, motion in enumerate(seen.motions):
        g = moved(there, torch.from_numpy(motion).to(device))
        for v, (viewmat, K) in enumerate(cameras):
            view = render_view(g, viewmat, K, (width, height), g.sh_degree, seen.cameras[v].low_pass)
            out[v, k] = view.rgb.cpu().numpy()
            release(out)
    return out


@dataclass(frozen=True)
class LinearisationPoint:
    """States that share Jacobians."""

    views: list[ViewJacobian]  # of all cameras, where things are in these states
    states: np.ndarray  # rows of `StateObservations.states`
    mixing: np.ndarray  # C_l [ρ, R]


def linearisation_points(
    gaussians: Gaussians, views: Sequence[ViewJacobian], fields: np.ndarray, observed: StateObservations
) -> list[LinearisationPoint]:
    """Choose linearisation points of the motion `fields` [R, N, 6]; `views`: the Jacobians at rest."""
    states, motions = observed.states, observed.moved(fields).motions
    points = states_of(states.gains.T, pixels_moved(views, fields[..., :3]), POINTS, POINT_PX)
    out = []
    for point in range(len(points.gains)):
        rows = np.flatnonzero(points.of == point)
        share = states.count[rows] / states.count[rows].sum()
        motion = torch.from_numpy(np.tensordot(share, motions[rows], 1).astype(np.float32))
        there = moved(gaussians, motion)
        is_large = len(points.gains) * sum(view.nbytes for view in views) > VIEW_BYTES
        height, width = observed.pictures.shape[2:4]
        each = (view_jacobian(there, camera, (width, height)) for camera in observed.cameras)
        jacobians = [view.stored() if is_large else view for view in each]
        out.append(LinearisationPoint(jacobians, rows, _root(states.products[rows].sum(0))))
    return out


def targets_at(
    points: Sequence[LinearisationPoint],
    fold: Fold,
    residuals: np.ndarray,
    fields: np.ndarray,
    observed: StateObservations,
) -> Iterator[np.ndarray]:
    """C_lᵀ times the target images [R, H, W, 3] of each point and view, one at a time: all are gigabytes at 1080p."""
    for point in points:
        for v in fold.views:
            shown = point.views[v].jvp(fields)
            point.views[v].release()
            yield observed.target_images(v, residuals, point.states, shown)


def coupled_operator(
    problem: Problem,
    at_rest: Problem,
    points: Sequence[LinearisationPoint],
    fold: Fold,
    smoothness_weight: float,
    targets: Iterable[np.ndarray],
) -> tuple[Operator, Array]:
    """One fold with the views of all points, and its right-hand sides.

    What is projected out is as in the problem `at_rest` of the linear fit.
    """
    rest = problem.on_cpu(fold, smoothness_weight)
    views, rows = [point.views[v] for point in points for v in fold.views], [*fold.views] * len(points)
    weights = None if rest.weights is None else np.concatenate([rest.weights] * len(points))
    nuisances: list[Nuisance] = []
    if at_rest.nuisances:
        nuisances = [replace(at_rest.nuisances[v], view=one) for v, one in zip(rows, views, strict=True)]
    means = None if at_rest.means is None else [at_rest.means[v] for v in rows]
    projections = projections_of(nuisances, means, weights)
    plain = replace(rest, views=views, weights=weights, projections=projections)
    mixing = [point.mixing for point in points for _ in fold.views]
    there = views_on(problem.device, views, problem.graph)
    b = operator_on(there, plain).right_hand_sides(targets)
    return operator_on(there, replace(plain, mixing=mixing)), b


def _root(products: np.ndarray) -> np.ndarray:
    """C [ρ, R] float32 with Cᵀ C = `products` [R, R]."""
    values, vectors = np.linalg.eigh(products)
    keep = values > 1e-9 * max(float(values[-1]), 1e-30)
    return (vectors[:, keep] * np.sqrt(values[keep])).T.astype(np.float32)


def linear_px(n_views: int) -> float:
    """Return the motion in pixels above which it is iterated: few cameras do not determine depth, which costs more.

    Of a vibration of a pixels a texture of wavelength w shows 1 − (π a / w)² / 2: at w = 3 .73 of 0.7 px, .93 of 0.35.
    """
    return MANY_CAMERAS_PX if n_views >= LEAST else ABOVE_PX


@dataclass(frozen=True)
class GaussNewtonState:
    """Start of an iteration."""

    gaussians: Gaussians
    fold_fields: np.ndarray  # [P, R, N, 6] of each fold
    smoothness_weight: float
    errors: Errors  # of the residual

    def arrays(self) -> Arrays:
        """Return the arrays of a checkpoint."""
        figures = self.smoothness_weight, self.errors.changes, self.errors.total
        return arrays_of(self.gaussians) | {"fold_fields": self.fold_fields, "figures": np.array(figures)}

    @staticmethod
    def restored(arrays: Arrays) -> "GaussNewtonState":
        """Return the state of a checkpoint's arrays."""
        weight, *errors = (float(f) for f in arrays["figures"][:3])
        return GaussNewtonState(gaussians_of(arrays), arrays["fold_fields"], weight, Errors(*errors))


def used_components(is_noise: np.ndarray) -> np.ndarray:
    """Return the temporal components to fit: those of the linear fit and as many others plus one, or eight in all.

    Pictures saturate where things move far, so that the first component is not quite what the motion does in time; the
    rest of that is in weaker ones. What is noise there after all fades by its reliability; but what moves and
    is left out counts as noise of its pixels, which then say less.
    """
    linear, others = np.flatnonzero(~is_noise), np.flatnonzero(is_noise)
    return np.sort(np.concatenate([linear, others[: max(len(linear) + 1, _COMPONENTS - len(linear))]]))


class GaussNewton:
    """Data shared by all iterations: pictures of states, components, folds, settings."""

    def __init__(self, model: TemporalModel, hyper: Hyperparameters, linear_fields: np.ndarray) -> None:
        """Start from the linear fit's fields [P, R', N, 6]."""
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
        """Return the last state, and the misfits along the way."""
        units = len(self.folds) * self.iterations * self._costs + self.refining
        with progress("Gauss-Newton", self.config.gauss_newton * units, "steps") as update:

            def step(state: GaussNewtonState, k: int) -> tuple[GaussNewtonState, float]:
                def report(done: int, **figures: Any) -> None:
                    update(k * units + done, iteration=k + 1, **figures)

                name = Step.gauss_newton.numbered(k)
                new = checkpoint(name, lambda: self._iterated(state, k, report).arrays())
                new_state = GaussNewtonState.restored(new)
                return new_state, new_state.errors.changes

            return iterated(self.start, self.start.errors.changes, step, self.config.gauss_newton)

    @property
    def _costs(self) -> int:
        """Steps of refining that an iteration of conjugate gradients takes."""
        return max(2 * len(self.observations.frames) // len(self.folds), 1)

    def _iterated(self, state: GaussNewtonState, k: int, report: Callable[..., None]) -> GaussNewtonState:
        """Return the state after one iteration, motion and then scene at rest; the same if neither step helps."""
        new, weight = self._solved(state, report)
        for length in (1.0, 0.5):
            stepped = (state.fold_fields + np.float32(length) * (new - state.fold_fields)).astype(np.float32)
            fields, _ = wiener_shrink(stepped)
            errors = self.observed.residuals(state.gaussians, fields, self.device)[1]
            if errors.changes < state.errors.changes:
                gaussians, after = self._refined(state.gaussians, fields, errors, k, report)
                return GaussNewtonState(gaussians, stepped, weight, after)
        return state

    def _refined(
        self, gaussians: Gaussians, fields: np.ndarray, errors: Errors, k: int, report: Callable[..., None]
    ) -> tuple[Gaussians, Errors]:
        """The scene at rest for this motion; the one before stays where it shows the pictures better."""
        if not self.refining:
            return gaussians, errors
        before = len(self.folds) * self.iterations * self._costs
        new = refine_rest_scene(
            gaussians, self.observed.moved(fields), self.refining, self.config.seed + k, self.device,
            lambda done: report(before + done),
        )  # fmt: skip
        after = self.observed.residuals(new, fields, self.device)[1]
        return (new, after) if after.is_no_larger(errors) else (gaussians, errors)

    def _solved(self, state: GaussNewtonState, report: Callable[..., None]) -> tuple[np.ndarray, float]:
        """Return [P, R, N, 6], each fold's solution in this iteration, and the newly chosen smoothness weight."""
        views = rest_views(state.gaussians, self.observations)
        problem = Problem.of(views, state.gaussians, self.config, self.device)
        problem = problem.changed(pixel_weights=self.weights)
        fields, _ = wiener_shrink(state.fold_fields)
        weight = state.smoothness_weight
        residuals, _ = self.observed.residuals(state.gaussians, fields, self.device)
        if not self.config.smoothness_weight and len(self.folds) == 2:
            images = self.rest_targets(residuals, views, fields, range(len(views)))
            target = np.stack([of_view[:1].copy() for of_view in images])
            weight = chosen_weight(target, problem, self.folds, _FOR_WEIGHT)
        points = linearisation_points(state.gaussians, views, fields, self.observed)
        solved = []
        for p, fold in enumerate(self.folds):
            targets = targets_at(points, fold, residuals, fields, self.observed)
            operator, b = coupled_operator(problem, self.at_rest, points, fold, weight, targets)

            def update(done: int, residual: float, p: int = p) -> None:
                report((p * self.iterations + done) * self._costs, residual=round(residual, 4))

            solution = pcg(operator, b, self.iterations, self.config.tolerance, update=update)
            solved.append(operator.fields(solution.theta))
        return np.stack(solved), weight

    def rest_targets(
        self, residuals: np.ndarray, views: Sequence[ViewJacobian], fields: np.ndarray, rows: Iterable[int]
    ) -> Iterator[np.ndarray]:
        """Return [R, H, W, 3] of some `views` at rest: the target images of fields [R, N, 6] and their residual."""
        states = np.arange(len(self.observed.states.gains))
        return (self.observed.target_images(v, residuals, states, views[v].jvp(fields)) for v in rows)


def gauss_newton(
    model: TemporalModel,
    hyper: Hyperparameters,
    folds: np.ndarray,
    judged: Sequence[int],
    checkpoint: Checkpoint,
) -> tuple[TemporalModel, np.ndarray, Iterator[np.ndarray], dict[str, Any]]:
    """Iterate from the linear fit's fields [P, R', N, 6].

    Return the model with its scene at rest and functions of time after the iterations, the folds' fields [P, R, N, 6],
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
