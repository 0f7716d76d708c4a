"""How regions of Gaussians shift in a camera's picture, frame by frame: what frequencies and phases are found from.

A region's shift along the picture's rows and columns in one frame is the least-squares solution of that frame's change
through the Jacobian, nuisance projected out: b = Eᵀ Jᵀ Δ summed over the region, A = Eᵀ Jᵀ J E, shift = A⁻¹ b with E
the camera's right and down axes. Nothing is smoothed over space or time, so its noise is that of the pictures.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tg4mm.core.progress import progress
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, concatenated
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import PosedView, ViewJacobian
from tg4mm.fit.motion.nuisance.first_look import FixedCameras
from tg4mm.fit.motion.nuisance.projection import Projection
from tg4mm.fit.motion.observations import PosedFrames, whole_pictures
from tg4mm.fit.motion.sinusoids import constant_and_trend
from tg4mm.fit.motion.solver.aggregates import Aggregates
from tg4mm.fit.motion.solver.problem import Problem

_PROBES = 4
_SEEN = 0.02  # of the median region's determinant: below it a region is not seen


@dataclass(frozen=True)
class RegionSeries:
    """Shifts of G regions in the F frames of one clock; a moving camera has axes and normal matrices per frame."""

    times_s: np.ndarray  # [F]
    sides: np.ndarray  # [F, G, 2] b, scene units⁻¹
    normals: np.ndarray  # [F or 1, G, 2, 2] A
    axes: np.ndarray  # [F or 1, 2, 3] right and down, unit vectors in the world

    def arrays(self) -> Arrays:
        """For a checkpoint."""
        return {"sides": self.sides, "normals": self.normals, "axes": self.axes}

    @staticmethod
    def restored(times_s: np.ndarray, arrays: Arrays) -> RegionSeries:
        """From what `arrays` gave."""
        return RegionSeries(times_s, arrays["sides"], arrays["normals"], arrays["axes"])

    def whitened(self) -> np.ndarray:
        """[F, 2G]: A^(-1/2) b, whose noise is that of one pixel, alike for all regions; 0 where nothing is seen."""
        values, vectors = np.linalg.eigh(self.normals)
        limit = _SEEN * np.median(values[..., 1][values[..., 1] > 0]) if (values > 0).any() else 1.0
        root = np.where(values > limit, 1 / np.sqrt(np.maximum(values, 1e-30)), 0)
        b = np.einsum(
            "fgij,fgi->fgj", np.broadcast_to(vectors, (len(self.sides), *vectors.shape[1:])), self.sides
        )
        return (root * b).reshape(len(b), -1)

    def phasors(self, functions: np.ndarray) -> np.ndarray:
        """[K, G, 2] complex: of least squares with functions of time [2K, F], as `sinusoids` gives them.

        Sums b_f over the functions, to be divided by A: E m. For one fixed camera. A constant and a trend are fitted
        besides.
        """
        design = np.concatenate([constant_and_trend(self.times_s), functions]).T
        solution = np.linalg.lstsq(design, self.sides.reshape(len(self.sides), -1), rcond=None)[0][2:]
        pairs = solution.reshape(-1, 2, *self.sides.shape[1:])
        return pairs[:, 0] + 1j * pairs[:, 1]


def region_series(seen: FixedCameras, problem: Problem, checkpoint: Checkpoint) -> list[RegionSeries]:
    """Every fixed camera's region shifts."""
    labels, out = labels_of(problem.aggregates), []
    with progress("region shifts", len(seen.views), "cameras") as update:
        for v, (frames, view) in enumerate(zip(seen.observations.frames, seen.views, strict=True)):

            def compute(v: int = v, frames: PosedFrames = frames, view: ViewJacobian = view) -> Arrays:
                mean, nuisance = seen.look.mean[v], seen.nuisances[v]
                projection = Projection.of(nuisance, mean, None) if nuisance.active.any() else None
                changes = (p - mean for p in whole_pictures(seen.observations, frames.rows))
                return RegionView(view, frames, projection, labels).series(changes, frames.times_s).arrays()

            out.append(RegionSeries.restored(frames.times_s, checkpoint(f"regions_{v}", compute)))
            update(v + 1)
    return out


def labels_of(aggregates: Aggregates) -> np.ndarray:
    """[N] int: the region of every Gaussian, the aggregates of the solver's coarse level."""
    return np.asarray(aggregates.tentative.indices)


@dataclass(frozen=True)
class RegionView:
    """Regions of Gaussians as one camera sees them."""

    view: ViewJacobian
    camera: PosedView
    projection: Projection | None  # of its nuisance; None: nothing is projected out
    labels: np.ndarray  # [N] the region of every Gaussian

    def series(self, changes: Iterable[np.ndarray], times_s: np.ndarray) -> RegionSeries:
        """Of the camera's changes [f, H, W, 3], a few frames at a time."""
        axes = self.camera.viewmat[:2, :3].astype(np.float64)
        sides = np.concatenate([self._sides(axes, some) for some in changes])
        return RegionSeries(times_s, sides, self._normals(axes)[None], axes[None])

    def _sides(self, axes: np.ndarray, changes: np.ndarray) -> np.ndarray:
        if self.projection is not None:
            changes = self.projection.out_of(changes)
            if self.projection.weights is not None:
                changes = changes * self.projection.weights[..., None]
        out = np.zeros((len(changes), len(self.labels), DOF), np.float32)
        self.view.vjp(np.ascontiguousarray(changes, np.float32), out)
        return _summed(out[..., :3] @ axes.T, self.labels)

    def _normals(self, axes: np.ndarray) -> np.ndarray:
        """[G, 2, 2], by Hutchinson's estimator: with a random sign on each region, products between regions cancel."""
        rng, count = np.random.default_rng(0), int(self.labels.max()) + 1
        signs = rng.choice(np.array([-1.0, 1.0]), (_PROBES, count))
        motions = np.zeros((2 * _PROBES, len(self.labels), DOF), np.float32)
        for p in range(_PROBES):
            for a in range(2):
                motions[2 * p + a, :, :3] = signs[p, self.labels, None] * axes[a]
        out = np.zeros_like(motions)
        weights = None if self.projection is None else self.projection.weights
        self.view.gauss_newton_product(motions, weights, out)
        if self.projection is not None:
            self.projection.correct(motions, out)
        sums = _summed(out[..., :3] @ axes.T, self.labels).reshape(_PROBES, 2, count, 2)
        mean = (sums * signs[:, None, :, None]).mean(0).transpose(1, 0, 2)
        values, vectors = np.linalg.eigh((mean + mean.transpose(0, 2, 1)) / 2)
        return np.einsum("gij,gj,gkj->gik", vectors, np.maximum(values, 0), vectors)


def moving_camera_series(
    regions: Iterable[RegionView], changes: Iterable[np.ndarray], times_s: np.ndarray
) -> RegionSeries:
    """Of a moving camera's frames [H, W, 3] less what is rendered at rest, each with its own Jacobian."""
    each: list[Arrays] = []
    with progress("region shifts", len(times_s), "frames") as update:
        for k, (own, change) in enumerate(zip(regions, changes, strict=True)):
            each.append(own.series([change[None]], times_s[k : k + 1]).arrays())
            own.view.release()
            if own.projection is not None:
                own.projection.release()
            update(k + 1)
    return RegionSeries.restored(times_s, concatenated(each))


def _summed(values: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """[F, G, 2]: sums of [F, N, 2] over regions."""
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(int(labels.max()) + 1))
    return np.add.reduceat(values[:, order].astype(np.float64), starts, axis=1)
