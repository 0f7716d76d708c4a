"""Uncertainty of every Gaussian's motion: noise, motion that the pictures do not show, and errors shared by all views.

Noise is the difference of two folds of the data.

Unseen motion. A fit that minimises |J x − y|² / σ² + x·P x / τ² has an error with the covariance A⁻¹ (σ² JᵀJ + τ² P)
A⁻¹, A = JᵀJ + P. The first part is noise. The second is motion that the prior suppresses: along the optical axis of a
single camera, behind an edge. It is sampled: motion is drawn from the prior edge by edge (`stiffness_root`), and each
draw is solved for like the motion (perturb and MAP: Papandreou & Yuille 2010). The size of motion, τ², follows from the
fit: x·P x is τ² times the number of coordinates that the pictures show, tr A⁻¹JᵀJ (MacKay 1992), which is estimated
with noise of variance 1. So unseen motion is assumed to be as large and as smooth as the seen. With few cameras the
draws are solved to a smaller residual than the motion: if stopped early, directions that hardly change the pictures
would seem known. With many, a few iterations suffice (after 8 and after 30 the draws agreed to 3 %).

Errors shared by all cameras. First, the residual of the pictures: noise averages out over a block of pixels, errors of
the model do not, and that block's mean over the slope of the picture is a possible displacement; a small part of it is
real. Second, the variation of the motion between neighbouring Gaussians: the prior has them move alike, so at a joint,
an edge or a contact it guesses on which side motion ends. The weights of both were calibrated on generated scenes with
known motion (docs/method.md, "Uncertainty").
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from tg4mm.capture.pictures import Window
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.amplitude_bias import Gain, PictureGain
from tg4mm.fit.motion.jacobian.view import (
    PosedView,
    ViewJacobian,
    along_and_across,
    blend_sum,
    depth_sensitivity,
    view_jacobian,
)
from tg4mm.fit.motion.nuisance.projection import Nuisance, nuisances_of
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.fit.motion.prior import stiffness_root
from tg4mm.fit.motion.solver.cpu import CpuOperator
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import deviation, mean_over_neighbours

DRAWS = 8  # along the sight few coordinates decide, which no mean over neighbours steadies
_FOR_FREEDOM = 2
ITERATIONS = 100
# Stopped at 3e-3, after a tenth fewer iterations, deviations along a single camera's sight were 9 times too small.
_TOLERANCE = 1e-4
BLOCK = 4  # pixels: side of what an error of the model reaches over
_OF_RESIDUAL = 0.04  # of the square of the displacement that the residual could be
_OF_VARIANCE = 2.5  # of the variance over 32 Gaussians
# of the variance of draws that many cameras do not show; alone, maximum likelihood gave 3.0, beside the attenuation's
# part 1.2
_OF_UNSEEN = 2.0
# Deviation along the sight of a single camera over the motion across: of directions that are equally likely in space
# 95 % have at most twice this ratio, 2k / √(1 + 4k²).
_ALONG_TO_ACROSS = 1.5
_FLAT = 0.01  # of the scene's mean squared slope: as flat as anything counts
_TINY = float(np.finfo(np.float32).tiny)
ENOUGH = 120_000  # pixels of a view


def unseen_motion(
    operator: CpuOperator,
    gradient_fields: np.ndarray,
    n_timesteps: int,
    seed: int = 0,
    update: Callable[[int], None] | None = None,
    n_draws: int = DRAWS,
    iterations: int = ITERATIONS,
) -> tuple[np.ndarray, float]:
    """Return the covariance of the displacement that the pictures do not show, and the degrees of freedom they show.

    For the operator of one uncoupled field and all R fields x [R, 4N, 3] that were found: covariance [N, 3, 3] float32,
    scene units squared, mean over T timesteps.
    """
    rng = np.random.default_rng(seed)
    energy = sum(_prior_energy(operator, x) for x in gradient_fields)
    white = _white_pictures(operator, rng)
    freedom_sides = operator.right_hand_sides(white)
    root = stiffness_root(operator.graph)
    draws = np.stack([_prior_draw(operator, root, rng) for _ in range(n_draws)])
    sides = np.concatenate([freedom_sides, draws])
    solution = pcg(
        operator, sides, iterations, _TOLERANCE,
        update=lambda i, r: update(i) if update is not None else None,
    )  # fmt: skip
    products = np.einsum("rpc,rpc->r", freedom_sides, solution.theta[:_FOR_FREEDOM], dtype=np.float64)
    freedom = max(float(products.mean()), 1.0)
    scale2 = energy / freedom
    u = operator.fields(solution.theta[_FOR_FREEDOM:])[..., :3].astype(np.float64)
    each = np.einsum("snc,snd->ncd", u, u) / len(u)
    covariance = mean_over_neighbours(each, operator.graph.knn) * (scale2 / n_timesteps)
    return covariance.astype(np.float32), freedom


def _white_pictures(operator: CpuOperator, rng: np.random.Generator) -> list[np.ndarray]:
    """Noise of variance 1 / W: Jᵀ W of it has the covariance Jᵀ W J."""
    out = []
    for k, view in enumerate(operator.views):
        shape = (_FOR_FREEDOM, *view.transmittance.shape, 3)
        white = rng.standard_normal(shape, dtype=np.float32)
        if operator.weights is not None:
            white /= np.sqrt(np.maximum(operator.weights[k], 1e-6))[..., None]
        out.append(white)
    return out


def _prior_energy(operator: CpuOperator, x: np.ndarray) -> float:
    """x·P x of a field x [4N, 3]."""
    product = np.zeros_like(x)
    operator.graph.add_prior(x, operator.smoothness_weight, operator.ridge, product)
    return float(operator.scale * np.einsum("pc,pc->", x, product, dtype=np.float64))


def _prior_draw(operator: CpuOperator, root: csr_matrix, rng: np.random.Generator) -> np.ndarray:
    """Right-hand side [P, 3] of a normal draw with covariance P."""
    stiff = root.T @ rng.standard_normal((root.shape[0], 3))
    ridge = rng.standard_normal((root.shape[1], 3))
    draw = np.sqrt(operator.smoothness_weight) * stiff + np.sqrt(operator.ridge) * ridge
    return operator.preconditioner.from_field((np.sqrt(operator.scale) * draw).astype(np.float32))


def coarser(problem: Problem, frames: Sequence[PosedFrames], enough: int = ENOUGH) -> Problem:
    """The problem in pictures of `enough` pixels or a little more; as it is where they have no more."""
    width, height = problem.size
    factor = int(np.sqrt(height * width / enough))
    if factor < 2:
        return problem
    window = Window.on(height, width, factor)
    small = [f.through(window, height) for f in frames]
    size = window.columns, window.rows
    views = [view_jacobian(problem.gaussians, f, size) for f in small]
    nuisances: Sequence[Nuisance] = ()
    if problem.nuisances:
        nuisances = nuisances_of(views, small, problem.gaussians.means.numpy(), problem.nuisances[0].active)
    weights = np.full((len(views), *size[::-1]), factor**2, np.float32)
    if problem.pixel_weights is not None:
        weights *= _binned(problem.pixel_weights[..., None], factor)[..., 0]
    means = None if problem.means is None else _binned(problem.means, factor)
    return problem.changed(
        views=views, pixel_weights=weights, nuisances=nuisances, means=means, projections=None
    )


def _binned(pictures: np.ndarray, factor: int) -> np.ndarray:
    """Return pictures [V, H, W, C] averaged over factor × factor pixels; incomplete squares are dropped."""
    n, height, width, channels = pictures.shape
    h, w = height // factor, width // factor
    blocks = pictures[:, : h * factor, : w * factor].reshape(n, h, factor, w, factor, channels)
    return np.ascontiguousarray(blocks.mean((2, 4), dtype=np.float32))


@dataclass(frozen=True)
class MotionEstimate:
    """The results of a fit that its uncertainty depends on."""

    folds: np.ndarray  # [2, R, N, 6]
    fields: np.ndarray  # [R, N, 6], what is kept of their mean
    gaussians: Gaussians
    knn: np.ndarray  # [N, count], the nearest Gaussians of each
    views: Sequence[ViewJacobian]  # some of those Gaussians
    cameras: Sequence[PosedView]
    residuals: Iterable[np.ndarray]  # [R, H, W, 3] of each of those views, of its target images
    gain: PictureGain = field(default_factory=PictureGain)  # of those views, once their residuals were read
    attenuation: Gain = field(default_factory=Gain)  # what the fields were multiplied by


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of each Gaussian's displacement, rms over time, scene units."""

    arrays: dict[str, np.ndarray]  # RUN/uncertainty.safetensors
    figures: dict[str, Any]
    notes: list[str] = field(default_factory=list)


def split_half_uncertainty(
    estimate: MotionEstimate, n_timesteps: int, unseen: np.ndarray | None = None
) -> Uncertainty:
    """Estimate from two folds of the data, the residual of both, and the motion that the pictures do not show.

    unseen [N, 3, 3]: covariance of draws of motion, mean over time (`unseen_motion`); None: it was not drawn.
    """
    a, b = estimate.folds[..., :3]
    noise = deviation(a, b, estimate.knn).astype(np.float64) ** 2
    variance = noise + _model_error(estimate)
    if unseen is not None:
        variance += _OF_UNSEEN * n_timesteps * np.trace(unseen, axis1=1, axis2=2)
    arrays = {
        name: np.sqrt(v / n_timesteps).astype(np.float32)
        for name, v in (("displacement", variance), ("noise", noise))
    }
    power = max(float((estimate.folds[..., :3].mean(0) ** 2).sum()), 1e-30)
    ratios = {"noise_to_motion": noise, "uncertainty_to_motion": variance}
    return Uncertainty(arrays, {name: math.sqrt(float(v.sum()) / power) for name, v in ratios.items()})


def with_ground(uncertainty: Uncertainty, squares: np.ndarray | None, n_timesteps: int) -> Uncertainty:
    """Add the error if another part is at rest: squares [N] of the fields' error (`nuisance/poses.py`)."""
    if squares is None:
        return uncertainty
    old = uncertainty.arrays
    ground = np.sqrt(squares / n_timesteps).astype(np.float32)
    arrays = old | {"displacement": np.hypot(old["displacement"], ground), "ground": ground}
    grown = np.linalg.norm(arrays["displacement"]) / max(float(np.linalg.norm(old["displacement"])), 1e-30)
    ratio = float(uncertainty.figures["uncertainty_to_motion"] * grown)
    return replace(uncertainty, arrays=arrays, figures=uncertainty.figures | {"uncertainty_to_motion": ratio})


def few_view_uncertainty(
    estimate: MotionEstimate, operator: CpuOperator, gradient_fields: np.ndarray, n_timesteps: int, seed: int
) -> Uncertainty:
    """`split_half_uncertainty` plus the motion that few cameras do not show; for one camera also along its sight."""
    with progress("uncertainty", ITERATIONS, "iterations") as update:
        unseen, freedom = unseen_motion(operator, gradient_fields, n_timesteps, seed, update)
    difference = (estimate.folds[0] - estimate.folds[1])[..., :3]
    each = np.einsum("rnc,rnd->ncd", difference, difference) / (4 * n_timesteps)
    noise = mean_over_neighbours(each, estimate.knn)
    model = _model_error(estimate) / (3 * n_timesteps)
    covariance = noise + unseen + model[:, None, None] * np.eye(3)
    if len(estimate.cameras) == 1:
        covariance += _unknown_direction(estimate, covariance, n_timesteps)
    covariance = covariance.astype(np.float32)
    variance = np.trace(covariance, axis1=1, axis2=2)
    power = max(float((estimate.fields[..., :3].astype(np.float64) ** 2).sum()) / n_timesteps, 1e-30)
    of_noise = np.trace(noise, axis1=1, axis2=2)
    arrays = {
        "displacement": np.sqrt(variance).astype(np.float32),
        "noise": np.sqrt(of_noise).astype(np.float32),
        "covariance": covariance,
    }
    figures: dict[str, Any] = {
        "noise_to_motion": math.sqrt(float(of_noise.sum()) / power),
        "uncertainty_to_motion": math.sqrt(float(variance.sum()) / power),
        "freedom": freedom,
    }
    if len(estimate.cameras) > 1:
        return Uncertainty(arrays, figures)
    along, guess = _along_viewing_rays(estimate, covariance, n_timesteps)
    figures["guess_along_sight_percent"] = round(100 * guess, 1)
    ratio = depth_sensitivity(estimate.views[0], estimate.cameras[0], estimate.gaussians.means.numpy(), seed)
    note = (
        f"one camera: motion along its line of sight changes the pictures {ratio:.2g} times as much as motion across, "
        f"so that {100 * guess:.0f} % of the variance of the motion along it is the prior's guess; "
        "a second camera from the side would show it"
    )
    return Uncertainty(arrays | along, figures, [note])


def _unknown_direction(estimate: MotionEstimate, covariance: np.ndarray, n_timesteps: int) -> np.ndarray:
    """Return [N, 3, 3]: what `covariance` [N, 3, 3] lacks along the sight of a single camera, scene units squared.

    The camera shows motion across its sight. If no direction in space is more likely than another, motion along it has
    the deviation `_ALONG_TO_ACROSS` times that across. Pictures from one place change too little with the rest to
    correct this (docs/method.md, "Uncertainty").
    """
    along, _ = along_and_across(estimate.cameras[0], estimate.gaussians.means.numpy())
    fields = estimate.fields[..., :3].astype(np.float64)
    across = (fields**2).sum((0, 2)) - (np.einsum("rnc,nc->rn", fields, along) ** 2).sum(0)
    least = _ALONG_TO_ACROSS**2 * mean_over_neighbours(across, estimate.knn) / n_timesteps
    lacking = np.maximum(least - np.einsum("nc,ncd,nd->n", along, covariance, along), 0)
    return lacking[:, None, None] * along[:, :, None] * along[:, None, :]


def _along_viewing_rays(
    estimate: MotionEstimate, covariance: np.ndarray, n_timesteps: int
) -> tuple[dict[str, np.ndarray], float]:
    """Return deviations [N] along and across the line of sight, and the guessed part of the motion along it.

    That is the variance of what is not known over that of the motion: what was found, squared, and what is not known.
    Gaussians that are seen count by their opacity.
    """
    along, _ = along_and_across(estimate.cameras[0], estimate.gaussians.means.numpy())
    variance = np.einsum("nc,ncd,nd->n", along, covariance, along)
    across = np.maximum(np.trace(covariance, axis1=1, axis2=2) - variance, 0) / 2
    shown = (np.einsum("rnc,nc->rn", estimate.fields[..., :3], along) ** 2).sum(0) / n_timesteps
    weights = np.zeros(len(estimate.gaussians))
    bins = estimate.views[0].bins
    rows = bins.order[: bins.n_visible]
    weights[rows] = estimate.gaussians.opacities.numpy()[rows]
    unknown = float((weights * variance).sum())
    guess = unknown / max(unknown + float((weights * shown).sum()), 1e-30)
    deviations = {"along_sight": variance, "across_sight": across}
    return {k: np.sqrt(np.maximum(v, 0)).astype(np.float32) for k, v in deviations.items()}, guess


def _model_error(estimate: MotionEstimate) -> np.ndarray:
    """Return [N] variance of the displacement, summed over functions of time."""
    variance = local_variance(estimate.fields[..., :3], estimate.knn)
    out = _OF_RESIDUAL * residual_displacement(estimate) + _OF_VARIANCE * variance
    return out + estimate.gain.squares(estimate.fields) + estimate.attenuation.squares(estimate.fields)


def local_variance(fields: np.ndarray, knn: np.ndarray) -> np.ndarray:
    """Return the variance [N] float64, scene units², of R fields [R, N, 3] over the nearest Gaussians `knn` [N, count].

    Sums over fields and over x, y, z.
    """
    out = np.zeros(fields.shape[1])
    for field_ in fields.astype(np.float64):
        squares = np.einsum("nc,nc->n", field_, field_)
        out += mean_over_neighbours(squares, knn) - (mean_over_neighbours(field_, knn) ** 2).sum(1)
    return np.maximum(out, 0)


def residual_displacement(estimate: MotionEstimate) -> np.ndarray:
    """Return [N] float64, scene units squared: the squared displacement that the residual of target images could be.

    Means of the squares over pixels by the blending weights of the nearest Gaussians; over the whole scene where no
    camera sees any of these. A surface counts as no flatter than a hundredth of the scene's mean squared slope.
    """
    means = estimate.gaussians.means.numpy()
    seen = np.zeros((len(means), 3))  # of the residual, of what a unit of displacement changes, of pixels
    for pictures, view, camera in zip(estimate.residuals, estimate.views, estimate.cameras, strict=True):
        down, right = np.gradient(view.over_white, axis=(0, 1))
        slopes = (down**2 + right**2).sum(-1)
        sums = blend_sum(view, np.stack([_of_blocks(pictures), slopes, np.ones_like(slopes)], -1))
        depth = means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        per_unit = np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / np.where(sums[:, 2] > 0, depth, 1)  # pixels
        sums[:, 1:] *= per_unit[:, None] ** 2
        seen += sums
    local, total = mean_over_neighbours(seen, estimate.knn), seen.sum(0)
    flat = _FLAT * local[:, 2] * total[1] / max(total[2], _TINY)
    squares = local[:, 0] / np.maximum(np.maximum(local[:, 1], flat), _TINY)
    return np.where(local[:, 2] > 0, squares, total[0] / max(total[1], _TINY))


def _of_blocks(pictures: np.ndarray) -> np.ndarray:
    """Return [H, W]: squares of the means over blocks of pictures [R, H, W, 3]; sums over pictures and channels."""
    height, width = pictures.shape[1:3]
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    means = np.add.reduceat(np.add.reduceat(pictures, rows, axis=1), columns, axis=2)
    tall, wide = np.diff(rows, append=height), np.diff(columns, append=width)
    means /= np.outer(tall, wide).astype(np.float32)[..., None]
    squares = np.einsum("rhwc,rhwc->hw", means, means)
    return np.asarray(squares.repeat(tall, 0).repeat(wide, 1))
