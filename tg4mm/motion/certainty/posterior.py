"""How sure the motion is where cameras are too few to be halved: samples of what the fit may have got wrong.

A fit that minimises |J x − D|² / σ² + x·P x / τ² has an error with the covariance
A⁻¹ (σ² JᵀJ + τ² P) A⁻¹, A = JᵀJ + P: noise of the pictures that came in, and motion that they do not show, of which the
prior made nothing. Both are drawn: noise as the fit's own residual with signs at random, in blocks, since what a model
gets wrong is alike in neighbouring pixels; motion edge by edge from the prior (`roots.py`). Each draw is solved for as
the motion was (perturb and MAP: Papandreou & Yuille 2010).

How large motion is, τ², is read off the fit: x·P x is τ² times the number of coordinates that the pictures do show,
tr A⁻¹JᵀJ (MacKay 1992), and that number is found with noise of variance 1. So unseen motion is taken to be as large and
as smooth as the seen.

What is seen less is found after more iterations. The draws are solved for to a smaller residual than the motion itself:
stopped early they would say that what hardly changes the pictures is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from tg4mm.motion.certainty.alike import BLOCK
from tg4mm.motion.certainty.halves import mean_around
from tg4mm.motion.prior.square_root import stiffness_root
from tg4mm.motion.rounds.moved import shown
from tg4mm.motion.solver.pcg import start, step_all
from tg4mm.motion.solver.problem import MotionProblem

DRAWS = 8  # of each kind; neighbours are averaged over besides
_FOR_FREEDOM = 4
_COVERED = 0.99  # transmittance of a pixel in which there is something
_ITERATIONS = 150
_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Posterior:
    """Covariance of the displacement's error, mean over T timesteps, scene units squared."""

    noise: np.ndarray  # [N, 3, 3] float32: from the pictures' noise
    unseen: np.ndarray  # [N, 3, 3] float32: from motion that they do not show
    freedom: float  # coordinates of the motion that the pictures show, of one component
    prior_scale: float  # τ, in the fit's own units

    @property
    def covariance(self) -> np.ndarray:
        return self.noise + self.unseen

    @property
    def deviation(self) -> np.ndarray:
        """[N] float32, scene units: standard deviation, root of the sum over x, y, z."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2)).astype(np.float32)


def posterior(
    problem: MotionProblem,
    pictures: np.ndarray,
    n_timesteps: int,
    seed: int = 0,
    update: Callable[[int], None] | None = None,
) -> Posterior:
    """The posterior of the motion that explains component images [V, R, H, W, 3].

    `update` is called with the number of draws solved for, of `n_solves`.
    """
    rng = np.random.default_rng(seed)
    solver = _Solver(problem, update or (lambda done: None))
    thetas = solver.solve(problem.right_hand_sides(pictures))
    fields = np.stack([problem.field(t) for t in thetas])
    energy = sum(_prior_energy(problem, problem.levels.field(t)) for t in thetas)
    freedom = _freedom(problem, solver, pictures.shape, rng)
    left = pictures - shown(problem, fields)
    covered = 3 * sum(int((view.transmittance < _COVERED).sum()) for view in problem.views)
    left *= np.float32(np.sqrt(max(covered, 1) / max(covered - freedom, 0.1 * covered, 1.0)))
    noise = [_resigned(left, rng) for _ in range(DRAWS)]
    of_noise = solver.solve(problem.right_hand_sides(np.stack(noise, 1)))
    root = stiffness_root(problem.graph)
    of_prior = solver.solve([_prior_draw(problem, root, rng) for _ in range(DRAWS)])
    scale2 = energy / freedom
    parts = [_covariance(problem, t) / np.float32(n_timesteps) for t in (of_noise, of_prior)]
    return Posterior(parts[0], parts[1] * np.float32(scale2), freedom, float(np.sqrt(scale2)))


def n_solves(n_components: int) -> int:
    """How many systems `posterior` solves for so many components."""
    return n_components + _FOR_FREEDOM + 2 * DRAWS


class _Solver:
    def __init__(self, problem: MotionProblem, update: Callable[[int], None]) -> None:
        self.problem, self.update, self.done = problem, update, 0

    def solve(self, sides: Sequence[np.ndarray]) -> list[np.ndarray]:
        """θ of each right-hand side, eight in step."""
        out: list[np.ndarray] = []
        for first in range(0, len(sides), 8):
            states = [start(b) for b in sides[first : first + 8]]
            for _ in range(_ITERATIONS):
                going = [k for k, s in enumerate(states) if s.relative_residual > _TOLERANCE]
                if not going:
                    break
                for k, stepped in zip(
                    going, step_all([states[k] for k in going], self.problem.normals), strict=True
                ):
                    states[k] = stepped
            out += [s.x for s in states]
            self.done += len(states)
            self.update(self.done)
        return out


def _prior_energy(problem: MotionProblem, x: np.ndarray) -> float:
    """x·P x of a field x [4N, 3]."""
    product = np.zeros_like(x)
    problem.graph.add_prior(x, problem.config.neighbours, problem.config.ridge, product)
    return float(problem.scale * (x.astype(np.float64) * product).sum())


def _freedom(
    problem: MotionProblem, solver: _Solver, shape: tuple[int, ...], rng: np.random.Generator
) -> float:
    """tr A⁻¹JᵀWJ, at least 1: noise z of variance 1 / W gives z·W J A⁻¹ JᵀW z on average."""
    size = (shape[0], _FOR_FREEDOM, *shape[2:])
    white = rng.standard_normal(size, dtype=np.float32)
    if problem.weights is not None:
        white /= np.sqrt(np.maximum(problem.weights, 1e-6))[:, None, ..., None]
    sides = problem.right_hand_sides(white)
    thetas = solver.solve(sides)
    products = [float((b.astype(np.float64) * t).sum()) for b, t in zip(sides, thetas, strict=True)]
    return max(float(np.mean(products)), 1.0)


def _resigned(left: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """[V, H, W, 3]: the sum of R residuals [V, R, H, W, 3], each with a sign drawn for every block of pixels."""
    v, r, height, width, _ = left.shape
    size = (v, r, -(-height // BLOCK), -(-width // BLOCK))
    blocks = rng.choice(np.array([-1, 1], np.float32), size)
    signs = np.repeat(np.repeat(blocks, BLOCK, 2), BLOCK, 3)[:, :, :height, :width]
    return np.asarray(np.einsum("vrhwc,vrhw->vhwc", left, signs), np.float32)


def _prior_draw(problem: MotionProblem, root: csr_matrix, rng: np.random.Generator) -> np.ndarray:
    """Right-hand side [P, 3] of a normal draw with covariance P."""
    n = root.shape[1]
    stiff = root.T @ rng.standard_normal((root.shape[0], 3))
    ridge = rng.standard_normal((n, 3))
    draw = np.sqrt(problem.config.neighbours) * stiff + np.sqrt(problem.config.ridge) * ridge
    return problem.levels.from_field((np.sqrt(problem.scale) * draw).astype(np.float32))


def _covariance(problem: MotionProblem, thetas: Sequence[np.ndarray]) -> np.ndarray:
    """[N, 3, 3] float32: mean of u uᵀ over the draws and over the Gaussians around each."""
    u = np.stack([problem.field(t)[:, :3] for t in thetas]).astype(np.float64)
    each = np.einsum("snc,snd->ncd", u, u) / len(u)
    return mean_around(each, problem.graph.knn).astype(np.float32)
