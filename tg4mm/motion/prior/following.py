"""How a Gaussian turns in a displacement that changes in space: as what it is made of does.

A displacement with gradient G changes a covariance Σ by GΣ + ΣGᵀ, to first order. A Gaussian follows by the rotation
that changes Σ most nearly so. For a ball that is half the curl; a flake or a needle stays in the surface or line that
it lies in, also where that shears.
"""

from __future__ import annotations

import numpy as np

# How much variances must differ, squared and relative to their sum, to say which way a Gaussian turns
_ALIKE = 0.02


def following(axes: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """[N, 9, 3] float32: from gradients of displacement to rotation vectors in radians, world axes.

    axes [N, 3, 3]: rotation matrices, whose columns the scales [N, 3] go with. Rows are gradients ∂u_of/∂x_along in the
    order (along, of). Within two principal axes a, b with variances s_a, s_b, a rotation W and a gradient G change the
    covariance by W_ab (s_b − s_a) and by G_ab s_b + G_ba s_a. Where s_a and s_b are alike that says nothing, and
    ½ (G_ab − G_ba) is taken.
    """
    variances = scales.astype(np.float64) ** 2
    out = np.zeros((len(axes), 3, 3, 3))  # along, of, about
    for k, a, b in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):  # ω_k = W_ab
        s_a, s_b = variances[:, a], variances[:, b]
        apart, alike = (s_b - s_a) ** 2, np.maximum(_ALIKE * (s_a + s_b) ** 2, 1e-60)
        of_ab = ((s_b - s_a) * s_b + alike / 2) / (apart + alike)
        of_ba = ((s_b - s_a) * s_a - alike / 2) / (apart + alike)
        e_a, e_b, about = axes[:, :, a], axes[:, :, b], axes[:, :, k]
        out += np.einsum("n,nj,ni,nk->njik", of_ab, e_b, e_a, about)  # G_ab = Σ e_a[i] e_b[j] ∂u_i/∂x_j
        out += np.einsum("n,nj,ni,nk->njik", of_ba, e_a, e_b, about)
    return out.reshape(-1, 9, 3).astype(np.float32)
