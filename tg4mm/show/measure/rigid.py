"""A region's rigid motion in every frame, by least squares through the Jacobian.

E [K, N, 6] holds the motions of the region's Gaussians for a unit of each degree of freedom: three translations along
the sensor's axes and three rotations about its centre, each Gaussian with its weight w. D is the same for the region
and for Gaussians that move with it, with weights w' ≥ w (`companions`). With the residual's pull-back s_f
(`residuals.py`) and the run's modal motion x_f, whose contribution was removed from the residual,

    A u_f  =  E·s_f + E·JᵀWJ (w' x_f)        A = E·JᵀWJ D,  noise of the right-hand side B = E·JᵀWJ E

so that the modes determine only Gaussians elsewhere, and the pictures alone those inside. With E in place of D, a
region cut out of a larger body would be held by the modes of its surroundings, since its seam does not open.

A is the change that the scene at rest predicts for a motion, and not all of it is in the pictures: texture that the
scene at rest has and the pictures lack carries no information on motion and biases the answer towards zero, along an
edge most of all (errors in variables, Fuller 1987). With e the scene at rest less the mean picture, a motion changes
the pictures by J D less the change of e, so that the answer to a true motion u* is (1 − A⁻¹ F) u*,

    F_kl  =  E_k·JᵀW (motion_l·∇e)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import false_changes
from tg4mm.show.measure.residuals import MeasuredView
from tg4mm.show.measure.stored_pass import HALVES

if TYPE_CHECKING:
    from tg4mm.show.measure.scene import Prepared, SharedClock


@dataclass(frozen=True)
class RigidBody:
    """A region as a rigid body."""

    weights: np.ndarray  # [N] float32, 0 … 1
    centre: np.ndarray  # [3] scene units
    radius: float  # rms distance from the centre, scene units
    axes: np.ndarray  # [A, 3], rows: unit vectors in the world; two of a flat capture, else three

    def motions(self, means: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return motions [6, N, 6] float32: one scene unit along each axis, one radian times `radius` about each.

        E for the body's weights [N], D for those of `companions`.
        """
        away = means - self.centre
        out = np.zeros((2 * len(self.axes), len(means), DOF), np.float32)
        for k, axis in enumerate(self.axes):
            out[k, :, :3] = axis
        for k, axis in enumerate(self.axes, len(self.axes)):
            out[k, :, :3] = np.cross(axis, away) / self.radius
            out[k, :, 3:] = axis / self.radius
        return out * weights[:, None]


@dataclass(frozen=True)
class Equations:
    """The equations of one body with K unknowns on one clock, for each half of the data."""

    normals: np.ndarray  # [2, F or 1, K, K] A
    noise: np.ndarray  # [2, F or 1, K, K] B
    right_hand_sides: np.ndarray  # [2, F, K]
    false: np.ndarray  # [2, K, K] F; 0 of a moving camera, which has no mean picture

    def along(self, axes: np.ndarray) -> "Equations":
        """Return the equations for other axes [3, 3], whose rows are unit vectors in the old axes."""
        turn = np.kron(np.eye(2), axes)
        normals, noise = (turn @ m @ turn.T for m in (self.normals, self.noise))
        return Equations(normals, noise, self.right_hand_sides @ turn.T, turn @ self.false @ turn.T)


def equations_of(
    bodies: Sequence[RigidBody],
    scene: "Prepared",
    clock: "SharedClock",
    views: Sequence[MeasuredView],
    step: Callable[[], None],
) -> list[Equations]:
    """Return the equations of several bodies from one pass over a clock's views.

    A moving camera has one view for each frame. `step` is called after each body in each half of each view.
    """
    means, fields, series, is_moving = scene.means, scene.modal.fields, clock.series, scene.is_moving
    motions = [body.motions(means, body.weights) for body in bodies]
    around = [companions(body, fields) for body in bodies]
    trials = [body.motions(means, w) for body, w in zip(bodies, around, strict=True)]
    n_frames, count, unknowns = series.shape[1], len(views) if is_moving else 1, len(motions[0])
    normals, noise = np.zeros((2, len(bodies), HALVES, count, unknowns, unknowns))
    known = np.zeros((len(bodies), HALVES, n_frames, unknowns))
    false = np.zeros((len(bodies), HALVES, unknowns, unknowns))
    own = [(w[:, None] * fields).reshape(len(fields), len(means) * DOF) for w in around]
    for k, view in enumerate(views):
        frames = slice(k, k + 1) if is_moving else slice(None)
        halves = list(view.models())
        for b, e in enumerate(motions):
            changes = None if is_moving else false_changes(view.view, view.mean, trials[b], False)
            for half, model in halves:
                if changes is not None:
                    back = model.adjoint(changes).reshape(unknowns, -1)
                    false[b, half] += e.reshape(unknowns, -1).astype(np.float64) @ back.T
                flat = model.normal(e).reshape(unknowns, -1)
                at = b, half, k if is_moving else 0
                normals[at] += flat @ trials[b].reshape(unknowns, -1).T
                noise[at] += flat @ e.reshape(unknowns, -1).T
                if len(fields):
                    known[b, half, frames] += (flat @ own[b].T @ series[:, frames]).T
                step()
        view.nuisance.release()
    for b, e in enumerate(motions):
        assert clock.right_hand_sides is not None
        known[b] += clock.right_hand_sides.summed(e, np.flatnonzero(bodies[b].weights))
    return [Equations(normals[b], noise[b], known[b], false[b]) for b in range(len(bodies))]


def companions(body: RigidBody, fields: np.ndarray) -> np.ndarray:
    """Return w' [N] float32: the body's weights, and elsewhere how closely a Gaussian moves with the body, 0 … 1.

    By the run's modal fields [R, N, 6]: ⟨m_n, m⟩ / ⟨m, m⟩ with m the body's mean displacement. Without motion in the
    body, nothing moves with it.
    """
    shifts, own = fields[..., :3], body.weights / body.weights.sum()
    mean = np.einsum("n,rnc->rc", own, shifts)
    power = float((mean**2).sum())
    if power <= 0:
        return body.weights
    alike = np.einsum("rnc,rc->n", shifts, mean) / power
    return np.maximum(body.weights, np.clip(alike, 0, 1)).astype(np.float32)
