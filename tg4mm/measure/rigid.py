"""A region's rigid motion in every frame, by least squares through the Jacobian.

E [K, N, 6] holds the motions of all Gaussians for a unit of each degree of freedom: three translations along the
sensor's axes and three rotations about its centre, each Gaussian by its weight w. With the residual's pull-back s_f
(`residuals.py`) and the run's modal motion x_f, whose picture was taken out of the residual,

    A u_f  =  E·s_f + E·JᵀWJ (w x_f)        A = E·JᵀWJ E

so that what the run's modes show of Gaussians outside the region stays out, and inside the pictures alone decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.measure.residuals import HALVES, MeasuredView
from tg4mm.motion.jacobian.packed import DOF


@dataclass(frozen=True)
class Body:
    """A region as a rigid body."""

    weights: np.ndarray  # [N] float32, 0 … 1
    centre: np.ndarray  # [3] scene units
    radius: float  # rms distance from the centre, scene units
    axes: np.ndarray  # [3, 3], rows: unit vectors in the world

    def motions(self, means: np.ndarray) -> np.ndarray:
        """E [6, N, 6] float32: by one scene unit along each axis, and by one radian times `radius` about each."""
        away = means - self.centre
        out = np.zeros((6, len(means), DOF), np.float32)
        for k, axis in enumerate(self.axes):
            out[k, :, :3] = axis
            out[3 + k, :, :3] = np.cross(axis, away) / self.radius
            out[3 + k, :, 3:] = axis / self.radius
        return out * self.weights[:, None]


@dataclass(frozen=True)
class Equations:
    """Of one body on one clock, halves of the data apart."""

    normals: np.ndarray  # [2, F or 1, 6, 6] A
    sides: np.ndarray  # [2, F, 6]


def equations_of(
    bodies: Sequence[Body],
    means: np.ndarray,
    views: Sequence[MeasuredView],
    sides: np.ndarray,
    fields: np.ndarray,
    series: np.ndarray,
    is_moving: bool = False,
) -> list[Equations]:
    """The equations of several bodies in one pass over a clock's views.

    sides [2, F, N, 6], fields [R, N, 6], series [R, F]. A moving camera has one view for each frame.
    """
    motions = [body.motions(means) for body in bodies]
    n_frames, count = sides.shape[1], len(views) if is_moving else 1
    normals = np.zeros((len(bodies), HALVES, count, 6, 6))
    known = np.zeros((len(bodies), HALVES, n_frames, 6))
    own = [(body.weights[:, None] * fields).reshape(len(fields), len(means) * DOF) for body in bodies]
    for k, view in enumerate(views):
        frames = slice(k, k + 1) if is_moving else slice(None)
        for half, weights, projection in view.projections():
            for b, e in enumerate(motions):
                product = np.zeros_like(e)
                view.view.gauss_newton_product(e, weights, product)
                if projection is not None:
                    projection.correct(e, product)
                flat = product.reshape(6, -1)
                normals[b, half, k if is_moving else 0] += flat @ e.reshape(6, -1).T
                if len(fields):
                    known[b, half, frames] += (flat @ own[b].T @ series[:, frames]).T
        view.nuisance.__dict__.pop("pose", None)
    out = []
    for b, e in enumerate(motions):
        rows = np.flatnonzero(bodies[b].weights)
        flat = e[:, rows].reshape(6, -1).astype(np.float64)
        own_sides = [_summed(sides[h], rows, flat) for h in range(HALVES)]
        out.append(Equations(normals[b], known[b] + np.stack(own_sides)))
    return out


def _summed(sides: np.ndarray, rows: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """[F, 6]: E·s_f of sides [F, N, 6] over the Gaussians `rows`, motions [6, n · 6]."""
    return np.stack([motions @ frame[rows].reshape(-1) for frame in sides])
