"""Hyperparameters: components of noise, weights of pixels, and the smoothness of the motion.

Noise. A temporal component is noise if two folds of the data do not agree on its field after a few iterations. The
energy of such components gives every pixel's noise: shadows and gloss of a renderer, dark parts of a sensor. Pixels are
weighted by the inverse of their variance plus the mean variance, so that no weight exceeds twice the average.

Smoothness. The range over which motion is alike, and the noise, differ between scenes by orders of magnitude. So the
strongest component is fitted to one fold with prior weights in steps of a factor of 5.6, for a few iterations, and
judged by its prediction of the other fold, whose noise it has not seen (cross-validation). The range is extended while
the error falls at its end, and the error is interpolated in between. Errors of the model (edges, shading) are alike in
both folds and favour weights that are too small; hence the largest weight that explains nearly as much is used.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import Akima1DInterpolator
from scipy.ndimage import gaussian_filter

from tg4mm.core.memory import release
from tg4mm.core.progress import progress
from tg4mm.fit.motion.solver.cpu import CpuOperator, SharedPass
from tg4mm.fit.motion.solver.operator import Fold, Operator
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import reliability
from tg4mm.fit.motion.targets import TargetImages

LEAST = 10.0  # smoothness weight: with less, what fits both folds are errors of the model that they share
_FACTOR = 10**0.75  # from one candidate to the next
CANDIDATES = tuple(LEAST * _FACTOR**k for k in range(7))  # to 3·10⁵
_MORE = 2  # candidates beyond, if the last is best; with more than 10⁷ all motion is affine
DEFAULT = 300.0  # where the data are not split, or nothing changes
_STEP = 0.02  # of the logarithm of the weight
# what a larger weight may predict worse: a part of the least error, and of what the best weight explains, which in
# noise is much smaller
_WITHIN, _OF_EXPLAINED = 0.002, 0.02
_FEW = 4  # iterations for the candidates: their order is settled by then
_OF_PATCHES = 2  # times as many with patches: of 24,000 Gaussians 4 chose too smooth a motion, 8 did not
_LOOSE = 30.0  # smoothness weight while noise is looked for: where much holds them together noise agrees too
_FOR_NOISE = 2  # iterations; two to six give the same
_MIN_RELIABILITY = 0.5  # below it a component is noise: more than half of its field
_SMOOTHING_PX = 1.5  # standard deviation of what evens out estimates of noise
_AT_ONCE = 8  # components that share a pass over the views


@dataclass(frozen=True)
class Hyperparameters:
    """Hyperparameters estimated from the pictures before the fit."""

    is_noise: np.ndarray  # [R] bool, temporal components
    smoothness_weight: float

    @property
    def signal(self) -> np.ndarray:
        """Return the components that are fitted."""
        return np.flatnonzero(~self.is_noise)


def select_smoothness(images: np.ndarray, problem: Problem, folds: Sequence[Fold]) -> float:
    """Return the smoothness weight: that of the settings, if any; `DEFAULT` for a single fold."""
    if problem.config.smoothness_weight:
        return float(problem.config.smoothness_weight)
    if len(folds) == 1:
        return DEFAULT
    return chosen_weight(images, problem, folds, _FEW)


def noise_components(targets: TargetImages, problem: Problem, folds: Sequence[Fold]) -> np.ndarray:
    """Return [R] bool: components on which two folds disagree; never the known ones, or without these the strongest.

    None where there is one fold, one component, or where all are one system.
    """
    if len(folds) < 2 or len(targets.basis) < 2 or problem.mixing is not None:
        return np.zeros(len(targets.basis), bool)
    gains = []
    operators = [problem.operator(fold, _LOOSE, probes=4) for fold in folds]
    for first in range(0, targets.images.shape[1], _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        a, b = (
            _displacements(operator, (targets.of(v, some) for v in fold.views))
            for operator, fold in zip(operators, folds, strict=True)
        )
        gains.append(reliability((a + b) / 2, a, b))
    is_noise = np.concatenate(gains) < _MIN_RELIABILITY
    is_noise[: max(targets.n_known, 1)] = False
    return np.asarray(is_noise)


def _displacements(operator: Operator, images: Iterable[np.ndarray]) -> np.ndarray:
    """Return [R, N, 3] after a few iterations."""
    solution = pcg(operator, operator.right_hand_sides(images), _FOR_NOISE, 1e-6)
    return operator.fields(solution.theta)[..., :3]


def chosen_weight(images: np.ndarray, problem: Problem, folds: Sequence[Fold], iterations: int) -> float:
    """The smoothness weight for target images [V, ρ, H, W, 3], fitted to one fold and judged by the other.

    `DEFAULT` where the images of a fold do not change.
    """
    some, others = folds
    if not (images[some.views].any() and images[others.views].any()):
        return DEFAULT
    judge = problem.operator(others, DEFAULT)

    def fields_of(weights: Sequence[float]) -> list[np.ndarray]:
        operators = [problem.operator(some, value) for value in weights]
        count = iterations * (_OF_PATCHES if problem.aggregates.has_patches else 1)
        return few_iterations(operators, [images[v] for v in some.views], count)

    def error(fields: np.ndarray) -> float:
        return judge.misfit(fields, (images[v] for v in others.views))

    weights, fields = list(CANDIDATES), fields_of(CANDIDATES)
    still, errors = error(np.zeros_like(fields[0])), [error(f) for f in fields]
    if errors[-2] - errors[-1] > _margin(errors[-1], still) and errors[-1] == min(errors):
        more = [weights[-1] * _FACTOR**k for k in range(1, _MORE + 1)]
        weights, errors = weights + more, errors + [error(f) for f in fields_of(more)]
    return smoothest(np.array(weights), np.array(errors), still)


def smoothest(weights: np.ndarray, errors: np.ndarray, still: float) -> float:
    """Return the largest weight around the best one that explains nearly as much; the least where the next does not.

    weights [K], ascending, and their predictive errors [K], interpolated over the logarithm of the weight; still: the
    error without motion.
    """
    if not errors.argmin() and errors[1] - errors[0] > _margin(float(errors[0]), still):
        return float(weights[0])
    logs = np.log(weights)
    fine = np.linspace(logs[0], logs[-1], round((logs[-1] - logs[0]) / _STEP) + 1)
    curve = Akima1DInterpolator(logs, errors)(fine)
    best = int(curve.argmin())
    beyond = np.flatnonzero(curve[best:] > curve[best] + _margin(float(curve[best]), still))
    return float(np.exp(fine[best + beyond[0] - 1 if len(beyond) else -1]))


def _margin(least: float, still: float) -> float:
    """Return by how much a weight may predict worse than the best one and still explain nearly as much."""
    return min(_WITHIN * least, _OF_EXPLAINED * max(still - least, 0))


def few_iterations(
    operators: Sequence[Operator], images: Sequence[np.ndarray], iterations: int
) -> list[np.ndarray]:
    """Fields [R, N, 6] of each operator after so many iterations; on the CPU they share their passes over the views."""
    on_cpu = [o for o in operators if isinstance(o, CpuOperator)]
    with progress("smoothness", iterations * (1 if on_cpu else len(operators)), "iterations") as update:
        if not on_cpu:
            fields = []
            for k, o in enumerate(operators):
                solution = pcg(o, o.right_hand_sides(images), iterations, 1e-6)
                fields.append(o.fields(solution.theta))
                update((k + 1) * iterations)
            return fields
        shared = SharedPass(on_cpu)
        b = shared.right_hand_sides(images)
        coupled = len(b) // len(on_cpu) if on_cpu[0].is_coupled else 1
        theta = pcg(shared, b, iterations, 1e-6, together=coupled, update=lambda done, _: update(done)).theta
    return [o.fields(t) for o, t in zip(on_cpu, theta.reshape(len(on_cpu), -1, *b.shape[1:]), strict=True)]


def pixel_weights(
    targets: TargetImages, is_noise: np.ndarray, are_separate: bool = True
) -> np.ndarray | None:
    """Return [V, H, W] float32, at most 1, from the variance of what is noise; None where nothing is known of it.

    `are_separate`: target images belong to one component each, so that those of noise are noise.
    """
    variance = pixel_noise(targets, is_noise if are_separate else np.zeros(targets.images.shape[1], bool))
    noisy = variance[variance > 0]
    if not len(noisy):
        return None
    return np.asarray(1 / (1 + variance / noisy.mean(dtype=np.float64)), np.float32)


def pixel_noise(targets: TargetImages, is_noise: np.ndarray) -> np.ndarray:
    """Return [V, H, W] float32: variance of the noise in one pixel and channel of one target image.

    From what is not motion: the components that were not kept, and of the kept ones those that `is_noise` [ρ] bool
    names. Their energy, mean over channels, is divided by the number of components that hold it and smoothed (Gaussian
    of 1.5 px, edges reflected). Zeros where there are no such components. Where more components stood out than were
    asked for, those left out count as noise: the estimate is then too large. Raises ValueError on another ρ.
    """
    n_kept = targets.images.shape[1]
    if np.shape(is_noise) != (n_kept,):
        raise ValueError(f"is_noise has shape {np.shape(is_noise)}, expected ({n_kept},)")
    rows = np.flatnonzero(is_noise)
    freedom = max(targets.rank - n_kept, 0) + len(rows)
    if not freedom:
        return np.zeros_like(targets.residual_energy)
    energy = targets.residual_energy if targets.rank > n_kept else np.zeros_like(targets.residual_energy)
    for r in rows:
        energy = energy + np.einsum("vhwc,vhwc->vhw", *2 * [targets.images[:, r]]) / 3
        release(targets.images)
    sigma = (0, _SMOOTHING_PX, _SMOOTHING_PX)
    return gaussian_filter(energy / np.float32(freedom), sigma, mode="reflect")
