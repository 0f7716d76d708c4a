"""How regions of Gaussians shift in a camera's picture, frame by frame: what frequencies and phases are found from.

A region's shift along the picture's rows and columns in one frame is the least-squares solution of that frame's change
through the Jacobian, nuisance projected out: b = Eᵀ Jᵀ Δ summed over the region, A = Eᵀ Jᵀ J E, shift = A⁻¹ b with E
the camera's right and down axes. Nothing is smoothed over space or time, so its noise is that of the pictures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.motion.checkpoints import Arrays, Checkpoint, concatenated
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.jacobian.view import PosedView, ViewJacobian
from tg4mm.motion.nuisance.first_look import FixedCameras
from tg4mm.motion.nuisance.projection import Projection
from tg4mm.motion.observations import PosedFrames, whole_pictures
from tg4mm.motion.sinusoids import constant_and_trend
from tg4mm.motion.solver.aggregates import Aggregates
from tg4mm.motion.solver.problem import Problem
from tg4mm.progress import progress

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
                own = fixed_camera_series(view, frames, projection, labels, changes, frames.times_s)
                return own.arrays()

            out.append(RegionSeries.restored(frames.times_s, checkpoint(f"regions_{v}", compute)))
            update(v + 1)
    return out


def labels_of(aggregates: Aggregates) -> np.ndarray:
    """[N] int: the region of every Gaussian, the aggregates of the solver's coarse level."""
    return np.asarray(aggregates.tentative.indices)


def fixed_camera_series(
    view: ViewJacobian,
    camera: PosedView,
    projection: Projection | None,
    labels: np.ndarray,
    changes: Iterable[np.ndarray],
    times_s: np.ndarray,
) -> RegionSeries:
    """Of one fixed camera's changes [f, H, W, 3], a few frames at a time."""
    axes = camera.viewmat[:2, :3].astype(np.float64)
    sides = [_sides(view, axes, projection, labels, some) for some in changes]
    normals = _normals(view, axes, projection, labels)
    return RegionSeries(times_s, np.concatenate(sides), normals[None], axes[None])


def moving_camera_series(
    views: Sequence[ViewJacobian],
    cameras: Sequence[PosedView],
    projections: Sequence[Projection | None],
    labels: np.ndarray,
    changes: Iterable[np.ndarray],
    times_s: np.ndarray,
) -> RegionSeries:
    """Of a moving camera's frames [H, W, 3] less what is rendered at rest, each with its own Jacobian."""
    each = []
    with progress("region shifts", len(views), "frames") as update:
        for k, (view, projection, change) in enumerate(zip(views, projections, changes, strict=True)):
            own = fixed_camera_series(
                view, cameras[k], projection, labels, [change[None]], times_s[k : k + 1]
            )
            each.append(own.arrays())
            view.release()
            if projection is not None:
                projection.release()
            update(k + 1)
    return RegionSeries.restored(times_s, concatenated(each))


def _sides(
    view: ViewJacobian,
    axes: np.ndarray,
    projection: Projection | None,
    labels: np.ndarray,
    changes: np.ndarray,
) -> np.ndarray:
    if projection is not None:
        changes = projection.out_of(changes)
        if projection.weights is not None:
            changes = changes * projection.weights[..., None]
    out = np.zeros((len(changes), len(labels), DOF), np.float32)
    view.vjp(np.ascontiguousarray(changes, np.float32), out)
    return _summed(out[..., :3] @ axes.T, labels)


def _normals(
    view: ViewJacobian, axes: np.ndarray, projection: Projection | None, labels: np.ndarray
) -> np.ndarray:
    """[G, 2, 2], by Hutchinson's estimator: with a random sign on each region, products between regions cancel."""
    rng = np.random.default_rng(0)
    count = int(labels.max()) + 1
    signs = rng.choice(np.array([-1.0, 1.0]), (_PROBES, count))
    motions = np.zeros((2 * _PROBES, len(labels), DOF), np.float32)
    for p in range(_PROBES):
        for a in range(2):
            motions[2 * p + a, :, :3] = signs[p, labels, None] * axes[a]
    out = np.zeros_like(motions)
    view.gauss_newton_product(motions, None if projection is None else projection.weights, out)
    if projection is not None:
        projection.correct(motions, out)
    sums = _summed(out[..., :3] @ axes.T, labels).reshape(_PROBES, 2, count, 2) * signs[:, None, :, None]
    mean = sums.mean(0).transpose(1, 0, 2)
    mean = (mean + mean.transpose(0, 2, 1)) / 2
    values, vectors = np.linalg.eigh(mean)
    return np.einsum("gij,gj,gkj->gik", vectors, np.maximum(values, 0), vectors)


def _summed(values: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """[F, G, 2]: sums of [F, N, 2] over regions."""
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(int(labels.max()) + 1))
    return np.add.reduceat(values[:, order].astype(np.float64), starts, axis=1)
