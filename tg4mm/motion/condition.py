"""The same least-squares problem in parameters of like influence, so that conjugate gradients need half the iterations.

What the images say of a parameter, and what rigidity asks of it, differs by orders of magnitude between cells and
Gaussians: bright and faint, seen by all cameras or by one. Scaling every parameter by the fourth root of its place on
the operator's diagonal (a Jacobi preconditioner of half strength) evens that out. The full strength brings the residual
down faster still, but gives what is hardly seen as much say as what is seen well, and the field comes out worse for
the same iterations: docs/decisions.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tg4mm.motion.linear import DOF
from tg4mm.motion.problem import MotionProblem

_POWER = 0.5  # of the diagonal: 0 leaves the parameters as they are, 1 is Jacobi's
PROBES = 8  # random pictures for the images' part: 50 % spread, which a preconditioner bears
_STRAIN_PROBES = 16  # the neighbours' part costs little


@dataclass(frozen=True)
class Diagonals:
    """Estimates of the parts of an operator's diagonal, [P] each, mean over x, y, z."""

    images: np.ndarray
    strains: np.ndarray  # of the neighbours' term, for weight 1

    def of(self, problem: MotionProblem) -> np.ndarray:
        """[P] the whole diagonal, with the problem's weights; positive."""
        config = problem.config
        prior = config.neighbours * self.strains + config.ridge * problem.damping
        return np.asarray(self.images + problem.scale * prior)


def diagonals(
    problem: MotionProblem,
    rng: np.random.Generator,
    probes: int = PROBES,
    strain_probes: int = _STRAIN_PROBES,
) -> Diagonals:
    """For signs z drawn at random, the mean of (Bᵀ z)² is the diagonal of Bᵀ B, whatever lies beside it."""
    v_motions = np.zeros((probes, problem.sampling.shape[0], DOF), np.float32)
    for view in problem.views:
        shown = _signs(rng, (probes, *view.transmittance.shape, 3))
        view.pull_all(shown, v_motions, problem.buffers)
    images = [_squares(problem, problem.to_displacement(v)) for v in v_motions]
    strains = [_squares(problem, problem.around.from_random_strains(rng)) for _ in range(strain_probes)]
    return Diagonals(np.mean(images, 0), np.mean(strains, 0))


def conditioned(problem: MotionProblem, known: Diagonals) -> MotionProblem:
    """The problem of the scaled parameters φ, θ = E φ: same displacements, same minimum."""
    share = known.of(problem) ** (-_POWER / 2)
    share /= np.sqrt((share**2).mean())
    sampling = problem.sampling.copy()
    sampling.data *= share[sampling.indices].astype(np.float32)
    return replace(problem, sampling=sampling, damping=(problem.damping * share**2).astype(np.float32))


def _squares(problem: MotionProblem, v: np.ndarray) -> np.ndarray:
    """[P] from [N, 3]: mean square over x, y, z of what reaches each parameter."""
    return np.asarray((problem.to_parameters(v).astype(np.float64) ** 2).mean(1))


def _signs(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return (rng.integers(0, 2, shape, np.int8) * 2 - 1).astype(np.float32)
