"""A region's rigid motion in every frame, by least squares through the Jacobian.

E [K, N, 6] holds the motions of the region's Gaussians for a unit of each degree of freedom: translations along the
sensor's axes and rotations about its centre, three each, each Gaussian by its weight w. D is the same for the region
and for what goes with it, by weights w' ≥ w (`companions`). With the residual's pull-back s_f (`residuals.py`) and the
run's modal motion x_f, whose picture was taken out of the residual,

    A u_f  =  E·s_f + E·JᵀWJ (w' x_f)        A = E·JᵀWJ D,  noise of the right-hand side B = E·JᵀWJ E

so that what the run's modes show of Gaussians elsewhere stays out, and inside the pictures alone decide. With E in D's
place a region cut out of a larger body would be held by the modes of what lies around it: its seam does not open.

A is what the scene at rest would show of a motion, and not all of that is in the pictures: texture that the scene at
rest has and the pictures lack tells of no motion and draws the answer to zero, along an edge most of all (errors in
variables, Fuller 1987). With e the scene at rest less the mean picture, a motion changes the pictures by J D less the
change of e, so that of a true motion u* the answer holds (1 − A⁻¹ F) u*,

    F_kl  =  E_k·JᵀW (motion_l·∇e)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import false_changes
from tg4mm.show.measure.kept import HALVES, Sides
from tg4mm.show.measure.residuals import MeasuredView


@dataclass(frozen=True)
class Body:
    """A region as a rigid body."""

    weights: np.ndarray  # [N] float32, 0 … 1
    centre: np.ndarray  # [3] scene units
    radius: float  # rms distance from the centre, scene units
    axes: np.ndarray  # [A, 3], rows: unit vectors in the world; two of a flat capture, else three

    def motions(self, means: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """[6, N, 6] float32: by one scene unit along each of three axes, and by one radian times `radius` about each.

        E for the body's own weights [N], D for those of `companions`.
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
    """The equations of one body with K unknowns on one clock, halves of the data apart."""

    normals: np.ndarray  # [2, F or 1, K, K] A
    noise: np.ndarray  # [2, F or 1, K, K] B
    sides: np.ndarray  # [2, F, K]
    false: np.ndarray  # [2, K, K] F; 0 of a moving camera, which has no mean picture

    def along(self, axes: np.ndarray) -> "Equations":
        """The same for unknowns along other axes: `axes` [3, 3], rows unit vectors by their shares of the old ones."""
        turn = np.kron(np.eye(2), axes)
        normals, noise = (turn @ m @ turn.T for m in (self.normals, self.noise))
        return Equations(normals, noise, self.sides @ turn.T, turn @ self.false @ turn.T)


def equations_of(
    bodies: Sequence[Body],
    means: np.ndarray,
    views: Sequence[MeasuredView],
    sides: Sides,
    fields: np.ndarray,
    series: np.ndarray,
    is_moving: bool,
    step: Callable[[], None],
) -> list[Equations]:
    """The equations of several bodies in one pass over a clock's views.

    sides: what the pictures say of every Gaussian. fields [R, N, 6], series [R, F]. A moving camera has one view for
    each frame. `step` is called after each body in each half of each view.
    """
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
        known[b] += sides.summed(e, np.flatnonzero(bodies[b].weights))
    return [Equations(normals[b], noise[b], known[b], false[b]) for b in range(len(bodies))]


def companions(body: Body, fields: np.ndarray) -> np.ndarray:
    """[N] float32 w': the body's weights, and elsewhere by how much a Gaussian moves as the body does, 0 … 1.

    That is told by the run's modal fields [R, N, 6]: ⟨m_n, m⟩ / ⟨m, m⟩ with m the body's mean displacement. Where the
    run has no motion in the body, nothing goes with it.
    """
    shifts, own = fields[..., :3], body.weights / body.weights.sum()
    mean = np.einsum("n,rnc->rc", own, shifts)
    power = float((mean**2).sum())
    if power <= 0:
        return body.weights
    alike = np.einsum("rnc,rc->n", shifts, mean) / power
    return np.maximum(body.weights, np.clip(alike, 0, 1)).astype(np.float32)
