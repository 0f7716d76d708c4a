"""The Jacobian of projection: derivative of each Gaussian's splat by its displacement and rotation."""

# mypy: disable-error-code="no-untyped-call"

import numpy as np
from numba import float32, prange

from tg4mm.fit.motion.jacobian.packed import COLUMNS, DOF
from tg4mm.fit.rasterize.kernels import linearised
from tg4mm.fit.rasterize.kernels.compiled import kernel
from tg4mm.fit.rasterize.kernels.layout import SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import ROWS
from tg4mm.fit.rasterize.kernels.project_backward import backward_rows


@kernel()
def _of_some(means, quats, scales, sh, degree, camera, width, height, splats, columns, out):
    n = len(means)
    v_splats = np.zeros((n, SPLAT_WIDTH), np.float32)
    v_means, v_quats = np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    v_scales, v_opacities, v_pose = np.zeros((n, 3), np.float32), np.zeros(n, np.float32), v_means[:0]
    v_sh, half = np.zeros(sh.shape, np.float32), float32(0.5)
    for c in range(len(columns)):
        v_splats[:, columns[c]] = float32(1.0)
        v_means[:], v_quats[:] = float32(0.0), float32(0.0)
        backward_rows(
            means, quats, scales, sh, degree, False, camera, width, height, splats, v_splats, False,
            v_means, v_quats, v_scales, v_opacities, v_sh, v_pose, False,
        )  # fmt: skip
        v_splats[:, columns[c]] = float32(0.0)
        for i in range(n):
            w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
            vw, vx, vy, vz = v_quats[i, 0], v_quats[i, 1], v_quats[i, 2], v_quats[i, 3]
            out[i, c, :3] = v_means[i]
            # a rotation by small angles θ about the world's axes turns a quaternion q by (0, θ) q / 2
            out[i, c, 3] = half * (w * vx - x * vw + y * vz - z * vy)
            out[i, c, 4] = half * (w * vy - y * vw + z * vx - x * vz)
            out[i, c, 5] = half * (w * vz - z * vw + x * vy - y * vx)


@kernel(parallel=True)
def _of_all(means, quats, scales, sh, degree, camera, width, height, splats, columns, out):
    n = len(means)
    for chunk in prange((n + ROWS - 1) // ROWS):
        a, b = chunk * ROWS, min(n, chunk * ROWS + ROWS)
        _of_some(
            means[a:b], quats[a:b], scales[a:b], sh[a:b], degree, camera, width, height, splats[a:b], columns,
            out[a:b],
        )  # fmt: skip


def splat_jacobian(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    sh: np.ndarray,
    degree: int,
    camera: np.ndarray,
    size: tuple[int, int],
    splats: np.ndarray,
) -> np.ndarray:
    """[N, 8, DOF] float32: derivative of each Gaussian's mean, conic and colour by displacement and rotation.

    Of Gaussians [N] as `project_forward` takes them and the `splats` it gave for a packed camera and size (width,
    height); 0 for those it found invisible.
    """
    out = np.empty((len(means), COLUMNS, DOF), np.float32)
    _of_all(means, quats, scales, sh, degree, camera, *size, splats, linearised.COLUMNS, out)
    return out
