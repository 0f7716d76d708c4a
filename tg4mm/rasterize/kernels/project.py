"""Projection of 3D Gaussians to image splats (EWA), with spherical-harmonic colour, in one fused pass.

Formulas as in gsplat and [3DGS]: M = J W Σ Wᵀ Jᵀ + eps2d·I, the perspective Jacobian J taken at a position
clamped to 1.3 times the field of view.
"""

import math

import numpy as np
from numba import float32, njit, prange

from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.compiled import kernel
from tg4mm.rasterize.kernels.layout import (
    ALPHA_MIN,
    CA,
    CB,
    CC,
    DEPTH,
    EX,
    EY,
    FEAT,
    FEATURES,
    L22,
    MX,
    MY,
    OP,
    POWER,
    R11,
    SPLAT_WIDTH,
    SQUARES,
)
from tg4mm.rasterize.kernels.sh import basis

# Columns of `camera` [20] float32.
FX, FY, CX, CY = 12, 13, 14, 15  # after W row-major (0..8) and t (9..11)
NEAR, FAR, EPS2D, LEAST_ALPHA = 16, 17, 18, 19
ROWS = 256  # Gaussians that a thread takes at a time


def pack_camera(viewmat, K, near, far, eps2d, alpha_min=ALPHA_MIN):
    """Pack one camera: viewmat [4, 4] world-to-camera and K [3, 3] in pixels, to [20] float32."""
    cam = np.zeros(20, np.float32)
    cam[:9] = viewmat[:3, :3].ravel()
    cam[9:12] = viewmat[:3, 3]
    cam[12:16] = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    cam[16:20] = near, min(far, 3e38), eps2d, alpha_min
    return cam


@njit(fastmath=True, inline="always")
def rotation_of(quats, i):
    """Rotation matrix of quaternion i (wxyz, any length > 0) and the inverse of its length."""
    w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
    inv = float32(1.0) / math.sqrt(max(w * w + x * x + y * y + z * z, float32(1e-30)))
    w, x, y, z = w * inv, x * inv, y * inv, z * inv
    one, two = float32(1.0), float32(2.0)
    return (
        one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y),
        two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x),
        two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y),
        w, x, y, z, inv,
    )  # fmt: skip


@njit(fastmath=True, inline="always")
def camera_space(cam, x, y, z):
    return (
        cam[0] * x + cam[1] * y + cam[2] * z + cam[9],
        cam[3] * x + cam[4] * y + cam[5] * z + cam[10],
        cam[6] * x + cam[7] * y + cam[8] * z + cam[11],
    )


@njit(fastmath=True, inline="always")
def clamped(xz, centre, focal, size):
    """x/z limited to the image enlarged by 0.3 of half its field of view on each side (gsplat)."""
    margin = float32(0.15) * size / focal
    return min((size - centre) / focal + margin, max(-centre / focal - margin, xz))


@kernel(parallel=True, fastmath=True)
def project_forward(
    means, quats, scales, opacities, features, degree, with_depth, cam, width, height, splats
):
    """Fill `splats` [N, SPLAT_WIDTH]; what lies outside, behind or is too faint gets POWER = -1.

    features: [N, K, 3] SH coefficients where degree >= 0, else [N, 1, D] plain channels, D <= FEATURES.
    with_depth: 1 puts z into the last feature channel.
    """
    fx, fy, cx, cy = cam[FX], cam[FY], cam[CX], cam[CY]
    # camera centre -Wᵀ t
    ox = -(cam[0] * cam[9] + cam[3] * cam[10] + cam[6] * cam[11])
    oy = -(cam[1] * cam[9] + cam[4] * cam[10] + cam[7] * cam[11])
    oz = -(cam[2] * cam[9] + cam[5] * cam[10] + cam[8] * cam[11])
    n = means.shape[0]
    w, h = float32(width), float32(height)
    for chunk in prange((n + ROWS - 1) // ROWS):
        sh = np.empty(16, np.float32)
        for i in range(chunk * ROWS, min(n, chunk * ROWS + ROWS)):
            splats[i, POWER] = float32(-1.0)
            mx, my, mz = means[i, 0], means[i, 1], means[i, 2]
            x, y, z = camera_space(cam, mx, my, mz)
            power = math.log(max(opacities[i], float32(1e-20)) / cam[LEAST_ALPHA])
            if not (z > cam[NEAR] and z < cam[FAR] and power > float32(0.0)):
                continue
            r00, r01, r02, r10, r11, r12, r20, r21, r22, _, _, _, _, _ = rotation_of(quats, i)
            # B = W R S, so that the camera-space covariance is B Bᵀ
            s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
            b00 = (cam[0] * r00 + cam[1] * r10 + cam[2] * r20) * s0
            b01 = (cam[0] * r01 + cam[1] * r11 + cam[2] * r21) * s1
            b02 = (cam[0] * r02 + cam[1] * r12 + cam[2] * r22) * s2
            b10 = (cam[3] * r00 + cam[4] * r10 + cam[5] * r20) * s0
            b11 = (cam[3] * r01 + cam[4] * r11 + cam[5] * r21) * s1
            b12 = (cam[3] * r02 + cam[4] * r12 + cam[5] * r22) * s2
            b20 = (cam[6] * r00 + cam[7] * r10 + cam[8] * r20) * s0
            b21 = (cam[6] * r01 + cam[7] * r11 + cam[8] * r21) * s1
            b22 = (cam[6] * r02 + cam[7] * r12 + cam[8] * r22) * s2
            iz = float32(1.0) / z
            jx, jy = fx * iz, fy * iz
            jxz = -jx * clamped(x * iz, cx, fx, w)
            jyz = -jy * clamped(y * iz, cy, fy, h)
            # rows of J B
            p0, p1, p2 = jx * b00 + jxz * b20, jx * b01 + jxz * b21, jx * b02 + jxz * b22
            q0, q1, q2 = jy * b10 + jyz * b20, jy * b11 + jyz * b21, jy * b12 + jyz * b22
            pp, qq = p0 * p0 + p1 * p1 + p2 * p2, q0 * q0 + q1 * q1 + q2 * q2
            m00, m11 = pp + cam[EPS2D], qq + cam[EPS2D]
            m01 = p0 * q0 + p1 * q1 + p2 * q2
            # |p × q|² + eps (|p|² + |q|²) + eps²: m00 m11 - m01² without its cancellation in thin ellipses
            n0, n1, n2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
            det = n0 * n0 + n1 * n1 + n2 * n2 + cam[EPS2D] * (pp + qq + cam[EPS2D])
            if not (det > float32(0.0) and det < float32(1e37)):
                continue
            u, v = fx * x * iz + cx, fy * y * iz + cy
            ex, ey = math.sqrt(float32(2.0) * power * m00), math.sqrt(float32(2.0) * power * m11)
            if u + ex < float32(0.5) or u - ex > w - float32(0.5):
                continue
            if v + ey < float32(0.5) or v - ey > h - float32(0.5):
                continue
            inv = float32(1.0) / det
            splats[i, MX], splats[i, MY] = u, v
            splats[i, CA], splats[i, CB], splats[i, CC] = m11 * inv, -m01 * inv, m00 * inv
            splats[i, OP], splats[i, POWER], splats[i, DEPTH] = opacities[i], power, z
            splats[i, EX], splats[i, EY] = ex, ey
            splats[i, R11] = math.sqrt(det / (float32(SQUARES) * m11))
            splats[i, L22] = math.sqrt(float32(SQUARES) / m11)
            if degree >= 0:
                dx, dy, dz = mx - ox, my - oy, mz - oz
                norm = float32(1.0) / math.sqrt(dx * dx + dy * dy + dz * dz)
                basis(degree, dx * norm, dy * norm, dz * norm, sh)
                c0, c1, c2 = float32(0.5), float32(0.5), float32(0.5)
                for k in range((degree + 1) * (degree + 1)):
                    c0 += sh[k] * features[i, k, 0]
                    c1 += sh[k] * features[i, k, 1]
                    c2 += sh[k] * features[i, k, 2]
                splats[i, FEAT] = max(c0, float32(0.0))
                splats[i, FEAT + 1] = max(c1, float32(0.0))
                splats[i, FEAT + 2] = max(c2, float32(0.0))
                splats[i, FEAT + 3] = float32(0.0)
            else:
                for k in range(FEATURES):
                    splats[i, FEAT + k] = features[i, 0, k] if k < features.shape[2] else float32(0.0)
            if with_depth:
                splats[i, FEAT + FEATURES - 1] = z


def empty_splats(n: int) -> np.ndarray:
    """Storage for n projected Gaussians, each in a cache line of its own."""
    return Buffers().take("splats", (n, SPLAT_WIDTH))
