"""Unknowns of like influence, fine and coarse, so that conjugate gradients need few iterations.

What is seen well settles in a few iterations; what hardly costs anything, such as a whole part that sways, takes
hundreds, since a Gaussian hears of it only from its neighbours. So there are two levels of unknowns that add up: for
every Gaussian its own four rows, scaled by the inverse root of its block on the operator's diagonal, and for every one
of some hundred groups of Gaussians a displacement that is linear in space (`groups.py`), scaled by the inverse root of
the operator between groups. Conjugate gradients on these unknowns are those with an additive two-level preconditioner
(Schwarz). It changes neither the problem nor what it converges to.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from tg4mm.motion.jacobian.linear import RestView
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.prior.stiffness import ROWS, times_blocks
from tg4mm.motion.solver.groups import Groups
from tg4mm.rasterize.buffers import Buffers

PROBES = 8  # random pictures for the images' part of the diagonals: 50 % spread, which a preconditioner bears
# What images say of a Gaussian counts so many times beside the prior. Patches smaller than a group have no level of
# their own, and are well seen where the prior alone makes single Gaussians look stiff. By trial: docs/decisions.md.
_PATCH = 32.0


@dataclass(frozen=True)
class Levels:
    """x = B θ: θ [P, 3] holds 4 N rows of single Gaussians, then 4 G of groups."""

    blocks: np.ndarray  # [N, 4, 4] float32
    groups: Groups
    turn: np.ndarray  # [4G, 4G] float32

    @property
    def n_parameters(self) -> int:
        return ROWS * len(self.blocks) + len(self.turn)

    def field(self, theta: np.ndarray) -> np.ndarray:
        """θ [P, 3] -> x [4N, 3] float32."""
        fine = ROWS * len(self.blocks)
        x = self.groups.field(self.turn @ theta[fine:])
        return times_blocks(self._turned, theta[:fine], onto=x)

    def from_field(self, v: np.ndarray) -> np.ndarray:
        """The transpose of `field`: v [4N, 3] float32 -> [P, 3]."""
        fine = times_blocks(self.blocks, v)
        return np.concatenate([fine, self.turn.T @ self.groups.from_field(v)])

    @cached_property
    def _turned(self) -> np.ndarray:
        return np.ascontiguousarray(self.blocks.transpose(0, 2, 1))


@dataclass(frozen=True)
class Known:
    """What the images say of Gaussians and groups, whatever the prior's weight."""

    scale: float  # mean over Gaussians of what is said of one coordinate of displacement
    diagonal: np.ndarray  # [4N] float64
    between: np.ndarray  # [4G, 4G] float64

    @staticmethod
    def of(groups: Groups, answers: np.ndarray) -> Known:
        """From `probed` [probes, N, 6].

        Gaussians that move together are seen better than each by itself: neighbours share pixels, and of most groups
        they say two to three times what the diagonal alone makes of it. That factor is measured by the same probes.
        """
        said = information(answers)
        diagonal = np.empty((len(said), ROWS))
        diagonal[:, 0] = said[:, 0]
        diagonal[:, 1:] = said[:, 1:] / (4 * groups.graph.reach**2)  # a rotation is half the curl
        between = groups.seen(diagonal.ravel())
        together = _together(groups, answers, between.diagonal())
        between *= np.sqrt(together[:, None] * together)
        return Known(float(said[:, 0].mean()), diagonal.ravel(), between)


def _together(groups: Groups, answers: np.ndarray, alone: np.ndarray) -> np.ndarray:
    """[4G]: by what to multiply the diagonal `alone` of groups whose Gaussians are taken one by one.

    Eight probes know the factor to a third, hence halfway to the middle of all; and twice that, since the two levels
    add up. Both found by trial: docs/decisions.md. Where most groups are not seen at all that is 0: then the prior
    alone makes the coarse level, which costs iterations and no accuracy.
    """
    fields = (groups.from_field(groups.graph.from_motion(a)).astype(np.float64) for a in answers)
    factor = sum((v**2).mean(1) for v in fields) / len(answers) / np.maximum(alone, 1e-300)
    return np.asarray(2 * np.sqrt(factor * np.median(factor)))


def probed(
    views: list[RestView],
    n: int,
    rng: np.random.Generator,
    weights: np.ndarray | None = None,
    probes: int = PROBES,
) -> np.ndarray:
    """[probes, N, DOF] float32: Jᵀ W^½ z of pictures z of random signs, whose mean outer product is JᵀWJ."""
    v_motions, buffers = np.zeros((probes, n, DOF), np.float32), Buffers()
    for k, view in enumerate(views):
        shape = (probes, *view.transmittance.shape, 3)
        shown = (rng.integers(0, 2, shape, np.int8) * 2 - 1).astype(np.float32)
        view.pull_all(
            shown if weights is None else shown * np.sqrt(weights[k, ..., None]), v_motions, buffers
        )
    return v_motions


def information(answers: np.ndarray) -> np.ndarray:
    """[N, 2]: what the images say of displacement and of rotation, the diagonal of JᵀWJ, mean over x, y, z.

    From `probed`: the mean of (Jᵀ W^½ z)² is that diagonal, whatever lies beside it.
    """
    squares = (answers.astype(np.float64) ** 2).mean(0)
    return np.asarray(squares.reshape(len(squares), 2, 3).mean(2))


def levels(groups: Groups, known: Known, prior: float, ridge: float) -> Levels:
    """The levels of a problem: `prior` h λ, `ridge` h μ."""
    n = len(groups.smoother)
    own = prior * groups.graph.own_blocks
    own[:, range(ROWS), range(ROWS)] += (_PATCH * known.diagonal + ridge).reshape(n, ROWS)
    inverse = _inverse(np.linalg.cholesky(own)).transpose(0, 2, 1)
    between = prior * groups.stiffness + known.between + ridge * groups.squares
    return Levels(np.ascontiguousarray(inverse, np.float32), groups, _inverse_root(between))


def _inverse_root(matrix: np.ndarray) -> np.ndarray:
    """R [P, P] float32 with R Rᵀ the inverse of a symmetric positive `matrix`.

    By torch: scipy's two threads wait for each other in a loop, and where something else runs on the second core that
    takes 1.7 s for 1024 rows instead of 0.03.
    """
    lower = torch.linalg.cholesky(torch.from_numpy(matrix)).float()
    return np.ascontiguousarray(_inverse_lower(lower).T.numpy())


def _inverse_lower(lower: torch.Tensor) -> torch.Tensor:
    """Of a triangular matrix, by halves: half the time of solving for the unit matrix, whose zeros it would not see."""
    half = len(lower) // 2
    if half < 128:
        return torch.linalg.solve_triangular(lower, torch.eye(len(lower)), upper=False)
    out = torch.zeros_like(lower)
    out[:half, :half], out[half:, half:] = (
        _inverse_lower(lower[s, s]) for s in (slice(half), slice(half, None))
    )
    out[half:, :half] = -(out[half:, half:] @ lower[half:, :half]) @ out[:half, :half]
    return out


def _inverse(lower: np.ndarray) -> np.ndarray:
    """Of triangular matrices [N, 4, 4], all rows at once: an eighth of the time of a general inverse of each."""
    out = np.zeros_like(lower)
    for i in range(ROWS):
        out[:, i, i] = 1 / lower[:, i, i]
        for j in range(i):
            out[:, i, j] = -out[:, i, i] * np.einsum("nk,nk->n", lower[:, i, j:i], out[:, j:i, j])
    return out
