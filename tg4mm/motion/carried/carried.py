"""What surfaces carry along, and how motion blurs the mean: changes of pictures beyond the rendered derivative.

The change of a picture is that of the true scene, whose slopes the Gaussians show with an error: blurrier than they
are, as a rule, so that a motion found from the Gaussians' slopes alone comes out too large. What a camera saw on
average less what is rendered at rest is that error, and it moves along with the surfaces. That mean is itself blurred
by the motion, the more the larger it is, and slopes of the instant are steeper. To the third order in the displacement
u of a pixel, with M the mean over time, E = M − the picture at rest, orthonormal functions of time a_s and
u(t) = Σ a_s(t) u_s, component image s changes, beyond the derivative of the picture at rest, by

    − u_s·∇E + ½ (u_s·∇) 1/T Σ_r (u_r·∇)² M − 1/6 Σ_rqp (Σ_t a_s a_r a_q a_p) (u_r·∇)(u_q·∇)(u_p·∇) M.

A sinusoid of amplitude A leaves A²/8 (u·∇)³ M of the last two. Derivation and figures: docs/decisions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement
from math import factorial

import numpy as np
from numba import float32, prange

from tg4mm.motion.carried.flow import flow
from tg4mm.motion.jacobian.linear import RestView
from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.compiled import kernel

_STRONGEST = (
    4  # components whose cubes count: two frequencies, each with a phase that differs from place to place
)
_MARGIN = 2  # pixels beside one that its derivatives take in


@dataclass(frozen=True)
class Carried:
    """For cameras that saw `means` on average, and R orthonormal functions of time by falling energy."""

    views: Sequence[RestView]
    means: np.ndarray  # [V, H, W, 3] over white
    basis: np.ndarray  # [R, T]
    buffers: Buffers = field(default_factory=Buffers, compare=False)

    def of(self, v: int, shapes: np.ndarray) -> np.ndarray:
        """[R, H, W, 3] float32: what fields [R, N, DOF] change in component images of view `v`, see above."""
        view, mean = self.views[v], self.means[v]
        at_rest = view.image[..., :3] + view.transmittance[..., None]
        moves = flow(view, shapes, self.buffers)
        out = np.empty_like(moves)
        triples, cubes = self._cubes
        share = np.float32(1 / self.basis.shape[1])
        _carry(_with_margin(mean - at_rest), _with_margin(mean), moves, share, triples, cubes, out)
        return out

    @cached_property
    def _cubes(self) -> tuple[np.ndarray, np.ndarray]:
        """Triples of components [K, 3], and for each component what their products count, [R, K] float32."""
        triples = list(combinations_with_replacement(range(min(len(self.basis), _STRONGEST)), 3))
        cubes = np.empty((len(self.basis), len(triples)))
        for k, triple in enumerate(triples):
            orders = 6 / np.prod([factorial(triple.count(r)) for r in set(triple)])
            cubes[:, k] = self.basis @ self.basis[list(triple)].prod(0) * orders / 6
        return np.array(triples, np.int64), cubes.astype(np.float32)


def _with_margin(picture: np.ndarray) -> np.ndarray:
    return np.pad(picture, ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0)), mode="edge")


@kernel(parallel=True)
def _carry(error, mean, moves, share, triples, cubes, out):
    for y in prange(moves.shape[1]):
        _carry_row(y, error, mean, moves, share, triples, cubes, out)


@kernel()
def _carry_row(y, error, mean, moves, share, triples, cubes, out):
    n, _, width, _ = moves.shape
    thirds = np.empty((n, 4), np.float32)
    for x in range(width):
        _thirds(moves[:, y, x], share, triples, cubes, thirds)
        for c in range(3):
            right, down = _slopes(error, y, x, c)
            xxx, xxy, xyy, yyy = _third_derivatives(mean, y, x, c)
            for s in range(n):
                out[s, y, x, c] = (
                    thirds[s, 0] * xxx + thirds[s, 1] * xxy + thirds[s, 2] * xyy + thirds[s, 3] * yyy
                    - moves[s, y, x, 0] * right - moves[s, y, x, 1] * down
                )  # fmt: skip


@kernel()
def _thirds(u, share, triples, cubes, out):
    """[R, 4]: what the derivatives xxx, xxy, xyy, yyy of the mean are multiplied by, for displacements u [R, 2 …]."""
    xx, xy, yy = float32(0.0), float32(0.0), float32(0.0)
    for r in range(len(u)):
        xx += u[r, 0] * u[r, 0]
        xy += u[r, 0] * u[r, 1]
        yy += u[r, 1] * u[r, 1]
    half = float32(0.5) * share
    for s in range(len(u)):
        out[s, 0] = half * u[s, 0] * xx
        out[s, 1] = half * (float32(2.0) * u[s, 0] * xy + u[s, 1] * xx)
        out[s, 2] = half * (float32(2.0) * u[s, 1] * xy + u[s, 0] * yy)
        out[s, 3] = half * u[s, 1] * yy
    for k in range(len(triples)):
        a, b, c = u[triples[k, 0]], u[triples[k, 1]], u[triples[k, 2]]
        xxx, yyy = a[0] * b[0] * c[0], a[1] * b[1] * c[1]
        xxy = a[0] * b[0] * c[1] + a[0] * b[1] * c[0] + a[1] * b[0] * c[0]
        xyy = a[0] * b[1] * c[1] + a[1] * b[0] * c[1] + a[1] * b[1] * c[0]
        for s in range(len(u)):
            out[s, 0] -= cubes[s, k] * xxx
            out[s, 1] -= cubes[s, k] * xxy
            out[s, 2] -= cubes[s, k] * xyy
            out[s, 3] -= cubes[s, k] * yyy


@kernel()
def _slopes(p, y, x, c):
    """To the right and down, to the fourth order: fine detail is what the error is made of. p has a margin of 2."""
    y, x = y + 2, x + 2
    right = float32(8.0) * (p[y, x + 1, c] - p[y, x - 1, c]) - (p[y, x + 2, c] - p[y, x - 2, c])
    down = float32(8.0) * (p[y + 1, x, c] - p[y - 1, x, c]) - (p[y + 2, x, c] - p[y - 2, x, c])
    return right / float32(12.0), down / float32(12.0)


@kernel()
def _third_derivatives(p, y, x, c):
    y, x, half, two = y + 2, x + 2, float32(0.5), float32(2.0)
    xxx = half * (p[y, x + 2, c] - p[y, x - 2, c]) - (p[y, x + 1, c] - p[y, x - 1, c])
    yyy = half * (p[y + 2, x, c] - p[y - 2, x, c]) - (p[y + 1, x, c] - p[y - 1, x, c])
    below = p[y + 1, x + 1, c] - two * p[y + 1, x, c] + p[y + 1, x - 1, c]
    above = p[y - 1, x + 1, c] - two * p[y - 1, x, c] + p[y - 1, x - 1, c]
    right = p[y + 1, x + 1, c] - two * p[y, x + 1, c] + p[y - 1, x + 1, c]
    left = p[y + 1, x - 1, c] - two * p[y, x - 1, c] + p[y - 1, x - 1, c]
    return xxx, half * (below - above), half * (right - left), yyy
