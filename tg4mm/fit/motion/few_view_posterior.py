"""What the pictures do not show of the motion: samples of the posterior's part that comes from the prior.

A fit that minimises |J x − y|² / σ² + x·P x / τ² has an error with the covariance A⁻¹ (σ² JᵀJ + τ² P) A⁻¹,
A = JᵀJ + P. The first part is noise, which two halves of the data tell (`split_half.py`). The second is motion that the
pictures do not show, of which the prior made nothing: along the sight of a single camera, behind an edge. It is drawn:
motion edge by edge from the prior (`stiffness_root`), and each draw is solved for as the motion was (perturb and MAP:
Papandreou & Yuille 2010).

How large motion is, τ², is read off the fit: x·P x is τ² times the number of coordinates that the pictures do show,
tr A⁻¹JᵀJ (MacKay 1992), and that number is found with noise of variance 1. So unseen motion is taken to be as large and
as smooth as the seen.

With few cameras, what is seen less is found after more iterations. The draws are solved for to a smaller residual than
the motion itself: stopped early they would say that what hardly changes the pictures is known. With many cameras a few
iterations tell (after 8 and after 30 the draws were alike to 3 %).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from tg4mm.capture.window import Window
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.nuisance.projection import Nuisance, nuisances_of
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.fit.motion.prior.graph import stiffness_root
from tg4mm.fit.motion.solver.cpu import CpuOperator
from tg4mm.fit.motion.solver.pcg import pcg
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import mean_over_neighbours

DRAWS = 8  # along the sight few coordinates decide, which no mean over neighbours steadies
_FOR_FREEDOM = 2
ITERATIONS = 100
# Stopped at 3e-3, after a tenth fewer iterations, deviations along a single camera's sight were 9 times too small.
_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Unseen:
    """What the pictures do not show of the displacement, mean over T timesteps."""

    covariance: np.ndarray  # [N, 3, 3] float32, scene units squared
    freedom: float  # coordinates of the motion that the pictures show, of one component


def unseen_motion(
    operator: CpuOperator,
    gradient_fields: np.ndarray,
    n_timesteps: int,
    seed: int = 0,
    update: Callable[[int], None] | None = None,
    n_draws: int = DRAWS,
    iterations: int = ITERATIONS,
) -> Unseen:
    """For the operator of one uncoupled field and all R fields x [R, 4N, 3] that were found."""
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
    return Unseen(covariance.astype(np.float32), freedom)


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


ENOUGH = 120_000  # pixels of a view


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
    """[V, H, W, C] by the mean of factor × factor pixels; what is left over at the right and below is dropped."""
    n, height, width, channels = pictures.shape
    h, w = height // factor, width // factor
    blocks = pictures[:, : h * factor, : w * factor].reshape(n, h, factor, w, factor, channels)
    return np.ascontiguousarray(blocks.mean((2, 4), dtype=np.float32))
