"""Deferred correction: what a motion that was found shows beyond the derivative of rendering (Stetter 1978).

Taylor terms. A picture that moves by u changes by −u·∇M + ½ (u·∇)² M − …, M its mean over time. With orthonormal
functions of time a_s and u(t) = Σ a_s(t) u_s, the second-order term is in target image s

    ½ Σ_rq (Σ_t a_s a_r a_q) (u_r·∇)(u_q·∇) M.

The square of a sinusoid is another component, at twice its frequency, which must not be taken for motion. The first
term is what the Jacobian gives.

Appearance: gloss and shadows that go with the motion, as changes of colour (`appearance.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement

import numpy as np
from numba import float32, int64, prange

from tg4mm.motion.appearance import LOOK, AppearanceFit, Remainder
from tg4mm.motion.clocks.synchronous import Synchronous
from tg4mm.motion.hyperparameters import Hyperparameters
from tg4mm.motion.jacobian.pixels import optical_flow
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.linear_fit import Correction
from tg4mm.motion.split_half import LEAST
from tg4mm.progress import progress
from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.compiled import kernel

# components whose squares count, and no others': two frequencies, each with a phase that differs in places
_STRONGEST = 4
# pixels², of displacement: beyond it the series does not hold, and squares grow no more
_FAR = 1.5**2
_MARGIN = 2  # pixels beside one that its derivatives take in


@dataclass(frozen=True)
class TaylorTerms:
    """For views that saw `means` on average, and R orthonormal functions of time by falling energy."""

    views: Sequence[ViewJacobian]
    means: np.ndarray  # [V, H, W, 3] over white
    basis: np.ndarray  # [R, T]
    buffers: Buffers = field(default_factory=Buffers, compare=False)

    def of(self, v: int, fields: np.ndarray) -> np.ndarray:
        """[R, H, W, 3] float32: the second-order term of fields [R, N, 6] in the target images of view `v`."""
        flow = optical_flow(self.views[v], fields, self.buffers)
        out = np.empty_like(flow)
        _second_order(
            _with_margin(self.means[v]), flow, np.float32(1 / self.basis.shape[1]), self._pairs(), out
        )
        return out

    def _pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of components [K, 2], and by what their product counts for each component [R, K]."""
        pairs = list(combinations_with_replacement(range(min(len(self.basis), _STRONGEST)), 2))
        counts = np.empty((len(self.basis), len(pairs)), np.float32)
        for k, (a, b) in enumerate(pairs):
            counts[:, k] = self.basis @ (self.basis[a] * self.basis[b]) * (0.5 if a == b else 1.0)
        return np.array(pairs, np.int64), counts


def _with_margin(picture: np.ndarray) -> np.ndarray:
    """Continued with the slope it has at its edges."""
    beside = (_MARGIN, _MARGIN)
    return np.pad(picture, (beside, beside, (0, 0)), mode="reflect", reflect_type="odd")


@dataclass(frozen=True)
class DeferredCorrection:
    """Of synchronous cameras' fields."""

    clock: Synchronous
    terms: TaylorTerms
    colours: (
        AppearanceFit | None
    )  # None where it was not asked for, or cameras are too few to tell it from noise

    @staticmethod
    def of(clock: Synchronous, hyper: Hyperparameters) -> DeferredCorrection:
        problem = clock.problem
        terms = TaylorTerms(problem.views, clock.targets.mean, clock.basis)
        colours = None
        if clock.config.appearance and len(problem.views) >= LEAST and len(clock.folds) == 2:
            frames = clock.observations.frames
            colours = AppearanceFit.of(
                problem.views, frames, clock.gaussians, hyper.pixel_weights, problem.graph, clock.folds
            )
        return DeferredCorrection(clock, terms, colours)

    def between_passes(self, fields: np.ndarray) -> Correction:
        """For `LinearFit.second_pass`, given what the first pass's folds agree on, [R, N, 6]."""
        found = (
            None if self.colours is None else self.colours.fitted(self._remainder(fields, True), None, LOOK)
        )

        def pictures(p: int, own_fields: np.ndarray, some: slice) -> Iterator[np.ndarray]:
            for v in self.clock.folds[p].views:
                beyond = self.terms.of(int(v), own_fields)[some]
                if found is not None and self.colours is not None and found[0][some].any():
                    beyond = beyond + self.colours.shown(int(v), found[0][some])
                yield beyond

        return pictures

    def appearance(self, fields: np.ndarray, is_small: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Changes of colour [R, N, K, 3] that go with fields [R, N, 6], and their reliability [R].

        `is_small`: whether the motion is, so that the Taylor terms hold.
        """
        if self.colours is None:
            return None
        with progress("appearance", len(fields), "components") as update:
            return self.colours.fitted(self._remainder(fields, is_small), update)

    def _remainder(self, fields: np.ndarray, is_small: bool) -> Remainder:
        terms = self.terms.of if is_small else None
        return Remainder(self.clock.problem, self.clock.targets.images, self.clock.fitted, fields, terms)


@kernel(parallel=True)
def _second_order(mean, flow, share, pairs, out):
    for y in prange(flow.shape[1]):
        _row(int64(y), mean, flow, share, pairs, out)


@kernel()
def _row(y, mean, flow, share, pairs, out):
    n, _, width, _ = flow.shape
    factors = np.empty((n, 3), np.float32)
    for x in range(width):
        u = flow[:, y, x]
        if not u.any():  # background
            out[:, y, x] = float32(0.0)
            continue
        _factors(u, _within_reach(u, share), pairs, factors)
        for c in range(3):
            xx, xy, yy = _second_derivatives(mean, y, x, c)
            for s in range(n):
                out[s, y, x, c] = factors[s, 0] * xx + factors[s, 1] * xy + factors[s, 2] * yy


@kernel()
def _within_reach(u, share):
    """Of displacements u [R, 2 or more] of one pixel: 1, or by what the square of its amplitude comes to `_FAR`."""
    total = float32(0.0)
    for r in range(len(u)):
        total += u[r, 0] * u[r, 0] + u[r, 1] * u[r, 1]
    most = float32(2.0) * share * total  # a sinusoid's amplitude, squared
    return float32(_FAR) / most if most > float32(_FAR) else float32(1.0)


@kernel()
def _factors(u, near, pairs, out):
    """[R, 3]: what the derivatives xx, xy, yy of the mean are multiplied by."""
    out[:] = float32(0.0)
    which, counts = pairs
    for k in range(len(which)):
        a, b = u[which[k, 0]], u[which[k, 1]]
        xx, xy, yy = a[0] * b[0] * near, (a[0] * b[1] + a[1] * b[0]) * near, a[1] * b[1] * near
        for s in range(len(u)):
            out[s, 0] += counts[s, k] * xx
            out[s, 1] += counts[s, k] * xy
            out[s, 2] += counts[s, k] * yy


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
