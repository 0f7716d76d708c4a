"""What surfaces carry along, and how motion blurs the mean: changes of pictures beyond the rendered derivative.

The change of a picture is that of the true scene, whose slopes the Gaussians show with an error: blurrier than they
are, as a rule, so that a motion found from the Gaussians' slopes alone comes out too large. What a camera saw on
average less what is rendered at rest is that error, and it moves along with the surfaces. That mean is itself blurred
by the motion, the more the larger it is, and slopes of the instant are steeper. To the third order in the displacement
u of a pixel, with M the mean over time, E = M − the picture at rest, orthonormal functions of time a_s and
u(t) = Σ a_s(t) u_s, component image s changes, beyond the derivative of the picture at rest, by

    − w u_s·∇E + ½ Σ_rq (Σ_t a_s a_r a_q) (u_r·∇)(u_q·∇) M
    + ½ (u_s·∇) 1/T Σ_r (u_r·∇)² M − 1/6 Σ_rqp (Σ_t a_s a_r a_q a_p) (u_r·∇)(u_q·∇)(u_p·∇) M.

w, 0 … 1, is how far slopes of E are more than noise that stands still (`steady.py`). A sinusoid's squares are another
component, at twice its frequency, which must not be taken for motion; of an amplitude A along e, A²/8 (u·∇)(e·∇)² M is
left of the last two. Derivation and figures: docs/decisions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement
from math import factorial

import numpy as np
from numba import float32, int64, prange

from tg4mm.motion.carried.steady import slopes, trust
from tg4mm.motion.jacobian.flow import optical_flow
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.compiled import kernel

# components whose squares and cubes count, and no others': two frequencies, each with a phase that differs in places
_STRONGEST = 4
# pixels², of displacement: beyond it the series does not hold, and squares and cubes grow no more
_FAR = 1.5**2
_MARGIN = 2  # pixels beside one that its derivatives take in


@dataclass(frozen=True)
class Carried:
    """For cameras that saw `means` on average, and R orthonormal functions of time by falling energy."""

    views: Sequence[ViewJacobian]
    means: np.ndarray  # [V, H, W, 3] over white
    basis: np.ndarray  # [R, T]
    buffers: Buffers = field(default_factory=Buffers, compare=False)
    _trusted: dict[int, np.ndarray] = field(default_factory=dict, init=False, repr=False, compare=False)

    def of(self, v: int, shapes: np.ndarray) -> np.ndarray:
        """[R, H, W, 3] float32: what fields [R, N, DOF] change in component images of view `v`, see above."""
        view, mean = self.views[v], self.means[v]
        at_rest = view.image[..., :3] + view.transmittance[..., None]
        moves = optical_flow(view, shapes, self.buffers)
        out, error = np.empty_like(moves), _with_margin(mean - at_rest)
        if v not in self._trusted:
            self._trusted[v] = trust(error, view.transmittance < 0.5)
        right, down = (slope * self._trusted[v][..., None] for slope in slopes(error))
        share = np.float32(1 / self.basis.shape[1])
        _carry(right, down, _with_margin(mean), moves, share, self._squares, self._cubes, out)
        return out

    @cached_property
    def _squares(self) -> tuple[np.ndarray, np.ndarray]:
        return self._products(2)

    @cached_property
    def _cubes(self) -> tuple[np.ndarray, np.ndarray]:
        return self._products(3)

    def _products(self, power: int) -> tuple[np.ndarray, np.ndarray]:
        """Which components are multiplied [K, power], and by what their product counts for each component [R, K]."""
        which = list(combinations_with_replacement(range(min(len(self.basis), _STRONGEST)), power))
        counts = np.empty((len(self.basis), len(which)), np.float32)
        for k, of in enumerate(which):
            ways = factorial(power) / np.prod([factorial(of.count(r)) for r in set(of)])
            counts[:, k] = self.basis @ self.basis[list(of)].prod(0) * ways / factorial(power)
        return np.array(which, np.int64), counts


def _with_margin(picture: np.ndarray) -> np.ndarray:
    """Continued with the slope it has at its edges."""
    beside = (_MARGIN, _MARGIN)
    return np.pad(picture, (beside, beside, (0, 0)), mode="reflect", reflect_type="odd")


@kernel(parallel=True)
def _carry(right, down, mean, moves, share, squares, cubes, out):
    for y in prange(moves.shape[1]):
        _carry_row(int64(y), right, down, mean, moves, share, squares, cubes, out)


@kernel()
def _carry_row(y, right, down, mean, moves, share, squares, cubes, out):
    n, _, width, _ = moves.shape
    seconds, thirds = np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    for x in range(width):
        u = moves[:, y, x]
        if not u.any():  # background
            out[:, y, x] = float32(0.0)
            continue
        near = _near(u, share)
        _of_squares(u, near, squares, seconds)
        _of_cubes(u, share, near, cubes, thirds)
        for c in range(3):
            xx, xy, yy = _second_derivatives(mean, y, x, c)
            xxx, xxy, xyy, yyy = _third_derivatives(mean, y, x, c)
            for s in range(n):
                out[s, y, x, c] = (
                    seconds[s, 0] * xx + seconds[s, 1] * xy + seconds[s, 2] * yy
                    + thirds[s, 0] * xxx + thirds[s, 1] * xxy + thirds[s, 2] * xyy + thirds[s, 3] * yyy
                    - u[s, 0] * right[y, x, c] - u[s, 1] * down[y, x, c]
                )  # fmt: skip


@kernel()
def _near(u, share):
    """Of displacements u [R, 2 or more] of one pixel: 1, or by what the square of its amplitude comes to `_FAR`."""
    total = float32(0.0)
    for r in range(len(u)):
        total += u[r, 0] * u[r, 0] + u[r, 1] * u[r, 1]
    most = float32(2.0) * share * total  # a sinusoid's amplitude, squared
    return float32(_FAR) / most if most > float32(_FAR) else float32(1.0)


@kernel()
def _of_squares(u, near, squares, out):
    """[R, 3]: what the derivatives xx, xy, yy of the mean are multiplied by."""
    out[:] = float32(0.0)
    pairs, counts = squares
    for k in range(len(pairs)):
        a, b = u[pairs[k, 0]], u[pairs[k, 1]]
        xx, xy, yy = a[0] * b[0] * near, (a[0] * b[1] + a[1] * b[0]) * near, a[1] * b[1] * near
        for s in range(len(u)):
            out[s, 0] += counts[s, k] * xx
            out[s, 1] += counts[s, k] * xy
            out[s, 2] += counts[s, k] * yy


@kernel()
def _of_cubes(u, share, near, cubes, out):
    """[R, 4]: what the derivatives xxx, xxy, xyy, yyy of the mean are multiplied by."""
    strongest = min(len(u), _STRONGEST)
    xx, xy, yy = float32(0.0), float32(0.0), float32(0.0)
    for r in range(strongest):
        xx += u[r, 0] * u[r, 0]
        xy += u[r, 0] * u[r, 1]
        yy += u[r, 1] * u[r, 1]
    half = float32(0.5) * share * near
    out[strongest:] = float32(0.0)
    for s in range(strongest):
        out[s, 0] = half * u[s, 0] * xx
        out[s, 1] = half * (float32(2.0) * u[s, 0] * xy + u[s, 1] * xx)
        out[s, 2] = half * (float32(2.0) * u[s, 1] * xy + u[s, 0] * yy)
        out[s, 3] = half * u[s, 1] * yy
    triples, counts = cubes
    for k in range(len(triples)):
        a, b, c = u[triples[k, 0]], u[triples[k, 1]], u[triples[k, 2]]
        xxx, yyy = a[0] * b[0] * c[0] * near, a[1] * b[1] * c[1] * near
        xxy = (a[0] * b[0] * c[1] + a[0] * b[1] * c[0] + a[1] * b[0] * c[0]) * near
        xyy = (a[0] * b[1] * c[1] + a[1] * b[0] * c[1] + a[1] * b[1] * c[0]) * near
        for s in range(len(u)):
            out[s, 0] -= counts[s, k] * xxx
            out[s, 1] -= counts[s, k] * xxy
            out[s, 2] -= counts[s, k] * xyy
            out[s, 3] -= counts[s, k] * yyy


@kernel()
def _second_derivatives(p, y, x, c):
    """To the fourth order, of a picture with a margin of 2."""
    y, x = y + 2, x + 2
    here = float32(30.0) * p[y, x, c]
    xx = float32(16.0) * (p[y, x + 1, c] + p[y, x - 1, c]) - (p[y, x + 2, c] + p[y, x - 2, c]) - here
    yy = float32(16.0) * (p[y + 1, x, c] + p[y - 1, x, c]) - (p[y + 2, x, c] + p[y - 2, x, c]) - here
    xy = float32(16.0) * _twist(p, y, x, c, 1) - _twist(p, y, x, c, 2)
    return xx / float32(12.0), xy / float32(48.0), yy / float32(12.0)


@kernel()
def _twist(p, y, x, c, by):
    return (p[y + by, x + by, c] - p[y + by, x - by, c]) - (p[y - by, x + by, c] - p[y - by, x - by, c])


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
