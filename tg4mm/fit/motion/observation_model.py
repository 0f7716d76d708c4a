"""Observation model of one pose: visible motion and row times (docs/method.md, "Observation model").

Fields x change the pictures by A x = (1 − Q Qᵀ W) J x: the Jacobian without the part that nuisance explains. Aᵀ W maps
image residuals back to fields. With a rolling shutter each row is read at its own time, so its changes are multiplied
with the functions of time at that moment. No other part of the fit depends on row times.
"""

from dataclasses import dataclass

import numpy as np

from tg4mm.capture.tracking.row_times import row_delays
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian
from tg4mm.fit.motion.nuisance.projection import Nuisance, Projection
from tg4mm.fit.motion.observations import PosedFrames


@dataclass(frozen=True)
class ObservationModel:
    """Linear map from motion to the pictures of one pose, with their times."""

    frames: PosedFrames
    view: ViewJacobian
    # of its nuisance, in the metric of the weights; None: nothing is projected out
    projection: Projection | None
    weights: np.ndarray | None = None  # W [H, W] of pixels; None: 1

    @staticmethod
    def of(
        frames: PosedFrames, nuisance: Nuisance, mean: np.ndarray, weights: np.ndarray | None = None
    ) -> "ObservationModel":
        """Project out the active columns of the `nuisance` about the mean picture [H, W, 3]."""
        projection = Projection.of(nuisance, mean, weights) if nuisance.active.any() else None
        return ObservationModel(frames, nuisance.view, projection, weights)

    def without_nuisance(self, pictures: np.ndarray) -> np.ndarray:
        """Pictures [R, H, W, 3] with the nuisance columns projected out."""
        return pictures if self.projection is None else self.projection.out_of(pictures)

    def apply(self, fields: np.ndarray) -> np.ndarray:
        """A: the pictures [R, H, W, 3] of fields [R, N, 6]."""
        return self.without_nuisance(self.view.jvp(fields))

    def adjoint(self, pictures: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Aᵀ W: what pictures [R, H, W, 3] say of R fields, [R, N, 6]; added to `out` where it is given."""
        pictures = self.without_nuisance(pictures)
        if self.weights is not None:
            pictures = pictures * self.weights[..., None]
        if out is None:
            out = np.zeros((len(pictures), len(self.view.splats), DOF), np.float32)
        self.view.vjp(np.ascontiguousarray(pictures, np.float32), out)
        return out

    def normal(self, fields: np.ndarray) -> np.ndarray:
        """Aᵀ W A of fields [R, N, 6]."""
        out = np.zeros_like(fields)
        self.view.gauss_newton_product(fields, self.weights, out)
        if self.projection is not None:
            self.projection.correct(fields, out)
        return out

    def release(self) -> None:
        """Let go of memory that is filled again where it is asked for."""
        self.view.release()
        if self.projection is not None:
            self.projection.release()


def project(
    frames: PosedFrames, height: int, rows: slice, strip: np.ndarray, functions: np.ndarray
) -> np.ndarray:
    """Σ_f a_r(τ_f) strip[f], [R, rows, W, 3] float32: rows of all F pictures [F, rows, W, 3] of so many rows.

    functions [R, F]: a_r at the times of the pictures' middle rows. τ_f is a row's own time.
    """
    if not frames.readout_s:
        flat = functions.astype(np.float32) @ strip.reshape(len(strip), -1)
        return flat.reshape(len(functions), *strip.shape[1:])
    delays = row_delays(frames.readout_s, np.arange(rows.start, rows.stop), height)
    each = (frames.later(functions, d).astype(np.float32) for d in delays)
    return np.stack([np.tensordot(f, strip[:, k], 1) for k, f in enumerate(each)], axis=1)
