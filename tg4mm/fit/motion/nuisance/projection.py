"""Changes of complete pictures that are not motion of the scene: exposure and the camera's pose.

Per frame and to first order P n, with twelve columns P of one view: gain and offset of each colour channel (automatic
exposure, white balance, flicker of the light) and six of the pose (a camera that shakes). The coefficients n are of no
interest, so the columns are made orthonormal, Qᵀ W Q = 1 with pixel weights W, and projected out of pictures and
Jacobian alike: J becomes (1 − Q Qᵀ W) J. Least squares over motion and n together is then least squares over motion
(variable projection, Golub & Pereyra 1973).

In the normal operator the projection is a correction of low rank: Jᵀ W J − L Lᵀ with L = Jᵀ W Q, one [N, 6] array for
each column, and Jᵀ W J is what it was.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tg4mm.core.memory import mapped_zeros, release
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import PosedView, ViewJacobian, without_colour

GAIN, OFFSET, ROTATION, TRANSLATION = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
EXPOSURE, POSE = slice(0, 6), slice(6, 12)
COLUMNS = 12
_TINY = 1e-6  # of the largest eigenvalue of the columns' products: below it a column says nothing new
_IRLS_STEPS = 30  # of the rigid motion that most of the scene has
_SMALL = 0.05  # of the median distance: nearer than that counts no more
EXPOSURE_SHARE = 5e-3  # of the changes' energy: of cut-out pictures less exposure than that stays


@dataclass(frozen=True)
class Nuisance:
    """The columns of one view, and which of them are projected out."""

    view: ViewJacobian
    camera: PosedView
    means: np.ndarray  # [N, 3] float32, of the Gaussians at rest
    active: np.ndarray  # [12] bool

    @cached_property
    def pose(self) -> np.ndarray:
        """Return [6, H, W, 3] float32: what a unit rotation (radians) and translation about the camera change.

        A camera that turns about itself sees every Gaussian from the same side, and so in the same colour.
        """
        rotations, translations = np.split(rigid_fields(self.camera, self.means), 2)
        return np.concatenate([without_colour(self.view).jvp(rotations), self.view.jvp(translations)])

    def release(self) -> None:
        """Let go of the columns of the pose, 72 bytes a pixel: they are made again where they are asked for."""
        self.__dict__.pop("pose", None)

    def columns(self, mean: np.ndarray, active: np.ndarray | None = None) -> np.ndarray:
        """Return [k, H, W, 3] float32: the active columns for a mean picture [H, W, 3]."""
        active = self.active if active is None else active
        exposure = exposure_columns(mean)[active[EXPOSURE]]
        if not active[POSE].any():
            return exposure
        return np.concatenate([exposure, self.pose[active[POSE]]])

    def gram(
        self, mean: np.ndarray, active: np.ndarray | None = None, mask: np.ndarray | None = None
    ) -> np.ndarray:
        """Return [k, k] float64: products of the columns, over the pixels of a `mask` [H, W] of 0 and 1 (None: all)."""
        columns = self.columns(mean, active)
        if mask is not None:
            columns *= mask[..., None]
        flat = columns.reshape(-1, mean.size)
        return (flat @ flat.T).astype(np.float64)

    def explained_gram(self, mean: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Return products [F, F] of what the active columns explain of F frames, from products [12, F] with them."""
        if not self.active.any():
            return np.zeros((products.shape[1],) * 2)
        active = products[self.active]
        return active.T @ pseudo_inverse(self.gram(mean)) @ active

    def energy(self, mean: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Return [H, W]: energy over time of what the active columns explain, mean over channels."""
        if not self.active.any():
            return np.zeros(mean.shape[:2], np.float32)
        n = self.coefficients(mean, products, self.active)
        columns = self.columns(mean)
        return np.einsum("khwc,kl,lhwc->hw", columns, n @ n.T, columns, optimize=True) / 3

    def coefficients(self, mean: np.ndarray, products: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Return [k, F]: the least-squares n of F frames."""
        return pseudo_inverse(self.gram(mean, active)) @ products[active]


def exposure_columns(mean: np.ndarray) -> np.ndarray:
    """Return [6, H, W, 3] float32: gain and offset of each channel for a mean picture [H, W, 3]."""
    out = np.zeros((6, *mean.shape), np.float32)
    for c in range(3):
        out[c, ..., c], out[3 + c, ..., c] = mean[..., c], 1
    return out


def nuisances_of(
    views: Sequence[ViewJacobian], cameras: Sequence[PosedView], means: np.ndarray, active: np.ndarray
) -> list[Nuisance]:
    """One for each view."""
    return [Nuisance(v, c, means, active) for v, c in zip(views, cameras, strict=True)]


def rigid_fields(camera: PosedView, means: np.ndarray) -> np.ndarray:
    """Return [6, N, 6] float32: the motions of all Gaussians that look as the camera's own rotation and translation do.

    About and along the camera's x, y, z, for one radian and one scene unit.
    """
    axes = camera.viewmat[:3, :3].astype(np.float64)
    away = means + axes.T @ camera.viewmat[:3, 3]
    out = np.zeros((6, len(means), DOF), np.float32)
    for k, axis in enumerate(axes):
        out[k, :, :3], out[k, :, 3:] = np.cross(axis, away), axis
        out[3 + k, :, :3] = axis
    return out


def inner_products(nuisance: Nuisance, mean: np.ndarray, rows: slice, flat: np.ndarray) -> np.ndarray:
    """Return [12, F] float64: products of all columns with a strip of F changes, flattened [F, rows · W · 3]."""
    strip, colours = flat.reshape(len(flat), -1, 3), mean[rows].reshape(-1, 3)
    out = np.zeros((COLUMNS, len(flat)))
    for c in range(3):
        channel = strip[..., c]
        out[c], out[3 + c] = channel @ colours[:, c], channel.sum(1, dtype=np.float64)
    if nuisance.active[POSE].any():
        out[POSE] = nuisance.pose[:, rows].reshape(6, -1) @ flat.T
    return out


def without(nuisance: Nuisance, mean: np.ndarray, pictures: np.ndarray) -> np.ndarray:
    """Pictures [R, H, W, 3] with the active columns projected out."""
    if not nuisance.active.any():
        return pictures
    columns = nuisance.columns(mean).reshape(-1, mean.size)
    flat = pictures.reshape(len(pictures), -1)
    flat = flat - (flat @ columns.T @ pseudo_inverse(nuisance.gram(mean))).astype(np.float32) @ columns
    return flat.reshape(pictures.shape)


@dataclass(frozen=True)
class Projection:
    """The projection of one view in the metric of its pixel weights: 1 − Q Qᵀ W with Q = Σ root · columns."""

    nuisance: Nuisance
    mean: np.ndarray  # [H, W, 3]
    weights: np.ndarray | None  # [H, W]
    root: np.ndarray  # [k, columns] float32
    adjoint_columns: np.ndarray  # [k, N, 6] float32, L = Jᵀ W Q
    keeps: bool = True  # whether the nuisance's columns stay in memory

    @staticmethod
    def of(
        nuisance: Nuisance,
        mean: np.ndarray,
        weights: np.ndarray | None,
        is_stored: bool = False,
        keeps: bool = True,
    ) -> "Projection":
        """weights [H, W] or None for 1; mean [H, W, 3]. Where it `is_stored`, L lies in a temporary file."""
        columns = nuisance.columns(mean)
        weighted = columns if weights is None else columns * weights[..., None]
        gram = (weighted.reshape(len(columns), -1) @ columns.reshape(len(columns), -1).T).astype(np.float64)
        root = _inverse_root(gram).astype(np.float32)
        adjoint_columns = mapped_zeros(
            (len(root), len(nuisance.means), DOF), in_memory=0 if is_stored else None
        )
        nuisance.view.vjp(np.ascontiguousarray(np.tensordot(root, weighted, 1)), adjoint_columns)
        return Projection(nuisance, mean, weights, root, adjoint_columns, keeps)

    def release(self) -> None:
        """Let go of memory: of the pages of a temporary file, and of columns that it does not keep."""
        release(self.adjoint_columns)
        if not self.keeps:
            self.nuisance.release()

    def basis(self) -> np.ndarray:
        """Q [k, H, W, 3]."""
        return np.tensordot(self.root, self.nuisance.columns(self.mean), 1)

    def out_of(self, pictures: np.ndarray) -> np.ndarray:
        """Pictures [R, H, W, 3] with the columns projected out."""
        basis = self.basis()
        weighted = basis if self.weights is None else basis * self.weights[..., None]
        products = pictures.reshape(len(pictures), -1) @ weighted.reshape(len(basis), -1).T
        return pictures - np.tensordot(products, basis, 1)

    def coefficients(self, picture: np.ndarray) -> np.ndarray:
        """Return [12] of the columns, by least squares of a picture [H, W, 3]; weights 1, all columns active."""
        basis = self.basis()
        return self.root.T @ (basis.reshape(len(basis), -1) @ picture.ravel())

    def coefficients_of_motion(self, motion: np.ndarray) -> np.ndarray:
        """Return [12] of what a motion [N, 6] changes in the picture."""
        return self.root.T @ (self.adjoint_columns.reshape(len(self.root), -1) @ motion.ravel())

    def correct(self, motions: np.ndarray, v_motions: np.ndarray) -> None:
        """Subtract L Lᵀ of motions [R, N, 6] from `v_motions`: Jᵀ W J becomes the projected operator."""
        flat = self.adjoint_columns.reshape(len(self.adjoint_columns), -1)
        products = motions.reshape(len(motions), -1) @ flat.T
        v_motions -= (products @ flat).reshape(v_motions.shape)


def projections_of(
    nuisances: Sequence[Nuisance], means: Sequence[np.ndarray] | None, weights: np.ndarray | None
) -> list[Projection] | None:
    """One a view, with its mean picture and pixel weights [V, H, W] or None; None where nothing is projected out."""
    if means is None or not nuisances or not nuisances[0].active.any():
        return None
    each = zip(nuisances, means, [None] * len(nuisances) if weights is None else weights, strict=True)
    return [Projection.of(*arguments) for arguments in each]


def exposure(
    nuisances: Sequence[Nuisance],
    means: Sequence[np.ndarray],
    products: Sequence[np.ndarray],
    grams: Sequence[np.ndarray],
) -> tuple[float, float, float]:
    """Gain and offset (rms over frames and cameras, percent) and the share of the changes' energy that they hold."""
    active = np.arange(COLUMNS) < 6
    gains, offsets, energy, total = [], [], 0.0, 0.0
    for nuisance, mean, product, gram in zip(nuisances, means, products, grams, strict=True):
        n = nuisance.coefficients(mean, product, active)
        gains.append((n[:3] ** 2).mean())
        offsets.append((n[3:] ** 2).mean())
        energy += float(np.einsum("kf,kf->", n, product[active]))
        total += float(np.trace(gram))
    return 100 * np.sqrt(np.mean(gains)), 100 * np.sqrt(np.mean(offsets)), energy / max(total, 1e-30)


def pseudo_inverse(gram: np.ndarray, tiny: float = _TINY) -> np.ndarray:
    """Return the pseudo-inverse over the directions that the columns span."""
    root = _inverse_root(gram, tiny)
    return root.T @ root


def _inverse_root(gram: np.ndarray, tiny: float = _TINY) -> np.ndarray:
    """T [k', k] with T gram Tᵀ = 1 over the directions that the columns have, k' ≤ k."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    keep = values > tiny * values[-1]
    return (vectors[:, keep] / np.sqrt(values[keep])).T / scale


def rigid_columns(x: np.ndarray) -> np.ndarray:
    """Return [N, 3, 6]: what a turn about the origin (radians) and a shift move points x [N, 3] by."""
    out = np.zeros((len(x), 3, 6))
    out[:, 0, 1], out[:, 0, 2] = x[:, 2], -x[:, 1]  # ω × x
    out[:, 1, 0], out[:, 1, 2] = -x[:, 2], x[:, 0]
    out[:, 2, 0], out[:, 2, 1] = x[:, 1], -x[:, 0]
    out[:, range(3), range(3, 6)] = 1
    return out


def with_still_background(fields: np.ndarray, means: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Fields [R, N, 6] of one frequency less the rigid motions [R, 6] that most of the scene has.

    To fields that explain a moving camera's pictures any rigid motion of the whole scene may be added, since the
    camera's unknown pose takes it up. Of all these the one is taken in which most of the scene stands still: the rigid
    motion that is nearest to the field in the sum of distances, by iteratively reweighted least squares, is taken off.
    means [N, 3] scene units; weights [N]: how much of a Gaussian is seen.
    """
    centre = np.average(means, axis=0, weights=weights + 1e-12)
    design = np.roll(rigid_columns(means.astype(np.float64) - centre), 3, axis=2)  # shift, then turn
    u = fields[..., :3].astype(np.float64)
    trust = weights.astype(np.float64)
    rigid = np.zeros((len(fields), 6))
    for _ in range(_IRLS_STEPS):
        weighted = design * trust[:, None, None]
        gram = np.einsum("nci,ncj->ij", weighted, design)
        sides = np.einsum("nci,rnc->ri", weighted, u)
        rigid = np.linalg.lstsq(gram, sides.T, rcond=1e-9)[0].T
        distance = np.sqrt(((u - np.einsum("nci,ri->rnc", design, rigid)) ** 2).sum((0, 2)))
        trust = weights / np.maximum(distance, _SMALL * float(np.median(distance)) + 1e-12)
    out = fields.copy()
    out[..., :3] -= np.einsum("nci,ri->rnc", design, rigid).astype(np.float32)
    out[..., 3:] -= rigid[:, None, 3:].astype(np.float32)
    return out
