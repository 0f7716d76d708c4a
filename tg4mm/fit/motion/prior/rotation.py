"""A Gaussian's rotation from the displacement gradient at it, and fields to motions.

A displacement with gradient G changes a covariance Σ by GΣ + ΣGᵀ, to first order. A Gaussian rotates as changes Σ most
nearly so, in least squares. For a ball that is half the curl; a flake or a needle stays in the surface or line that it
lies in, also where that shears.
"""

import numpy as np

from tg4mm.fit.rasterize.kernels.compiled import kernel

# Squared difference of two variances, relative to their squared sum, below which the rotation tends to half the curl
_ISOTROPIC = 0.02


def gradient_to_rotation(axes: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """[N, 9, 3] float32: from gradients of displacement to rotation vectors in radians, world axes.

    axes [N, 3, 3]: rotation matrices, whose columns the scales [N, 3] go with. Rows are gradients ∂u_of/∂x_along in the
    order (along, of). Within two principal axes a, b with variances s_a, s_b, a rotation W and a gradient G change the
    covariance by W_ab (s_b − s_a) and by G_ab s_b + G_ba s_a. Where s_a = s_b that leaves W undetermined, and
    ½ (G_ab − G_ba) is taken.
    """
    variances = scales.astype(np.float64) ** 2
    out = np.zeros((len(axes), 3, 3, 3))  # along, of, about
    for k, a, b in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):  # ω_k = W_ab
        s_a, s_b = variances[:, a], variances[:, b]
        anisotropy, ridge = (s_b - s_a) ** 2, np.maximum(_ISOTROPIC * (s_a + s_b) ** 2, 1e-60)
        of_ab = ((s_b - s_a) * s_b + ridge / 2) / (anisotropy + ridge)
        of_ba = ((s_b - s_a) * s_a - ridge / 2) / (anisotropy + ridge)
        e_a, e_b, about = axes[:, :, a], axes[:, :, b], axes[:, :, k]
        out += np.einsum("n,nj,ni,nk->njik", of_ab, e_b, e_a, about)  # G_ab = Σ e_a[i] e_b[j] ∂u_i/∂x_j
        out += np.einsum("n,nj,ni,nk->njik", of_ba, e_a, e_b, about)
    return out.reshape(-1, 9, 3).astype(np.float32)


@kernel()
def _to_motion(rotations, field, motion):
    for i in range(len(rotations)):
        for d in range(3):
            motion[i, d] = field[i, d]
            total = rotations[i, 0, d] * field[i, 3]
            for k in range(1, 9):
                total += rotations[i, k, d] * field[i, 3 + k]
            motion[i, 3 + d] = total


@kernel()
def _from_motion(rotations, v_motion, v_field):
    for i in range(len(rotations)):
        x, y, z = v_motion[i, 3], v_motion[i, 4], v_motion[i, 5]
        for d in range(3):
            v_field[i, d] = v_motion[i, d]
        for k in range(9):
            v_field[i, 3 + k] = rotations[i, k, 0] * x + rotations[i, k, 1] * y + rotations[i, k, 2] * z


def to_motion(rotations: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Displacement and rotation [N, 6] of a field [N, 12] (displacement and gradient).

    rotations [N, 9, 3]: of `gradient_to_rotation`, in the gradient's units. All float32.
    """
    motion = np.empty((len(rotations), 6), np.float32)
    _to_motion(rotations, field, motion)
    return motion


def from_motion(rotations: np.ndarray, v_motion: np.ndarray) -> np.ndarray:
    """The transpose of `to_motion`: [N, 6] -> [N, 12]."""
    v_field = np.empty((len(rotations), 12), np.float32)
    _from_motion(rotations, v_motion, v_field)
    return v_field
