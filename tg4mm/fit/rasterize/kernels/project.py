"""Projection of 3D Gaussians to image splats (EWA), with spherical-harmonic colour, in one fused pass.

Formulas as in gsplat and [3DGS]: M = J W Σ Wᵀ Jᵀ + eps2d·I, the perspective Jacobian J taken at a position
clamped to 1.3 times the field of view.

Sixteen Gaussians at a time, a lane a Gaussian (`vector.py`).
"""

import math

import numpy as np
from numba import float32, int64

from tg4mm.core.memory import Buffers
from tg4mm.fit.rasterize.kernels.compiled import inlined, part, shared
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MIN, FEAT, FEATURES, POWER, SPLAT_WIDTH, SQUARES
from tg4mm.fit.rasterize.kernels.sh import colour
from tg4mm.fit.rasterize.simd import functions  # noqa: F401, roots and logarithms of vectors
from tg4mm.fit.rasterize.simd.memory import address, keep, load, number, put_number
from tg4mm.fit.rasterize.simd.rows import store_rows, transpose, transpose_threes
from tg4mm.fit.rasterize.simd.vector import LANES, broadcast, fma, movemask, select

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


@inlined
def unpacked(cam):
    """A packed camera as twenty numbers, which need no memory."""
    return (
        cam[0], cam[1], cam[2], cam[3], cam[4], cam[5], cam[6], cam[7], cam[8], cam[9],
        cam[10], cam[11], cam[12], cam[13], cam[14], cam[15], cam[16], cam[17], cam[18], cam[19],
    )  # fmt: skip


@inlined
def rotation(w, x, y, z):
    """Rotation matrix of a unit quaternion, row by row."""
    one, two = float32(1.0), float32(2.0)
    return (
        one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y),
        two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x),
        two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y),
    )  # fmt: skip


@inlined
def unit(w, x, y, z):
    """A quaternion of any length > 0 with length 1, and the inverse of what it had."""
    inv = float32(1.0) / math.sqrt(max(w * w + x * x + y * y + z * z, float32(1e-30)))
    return w * inv, x * inv, y * inv, z * inv, inv


@inlined
def camera_space(cam, x, y, z):
    return (
        cam[0] * x + cam[1] * y + cam[2] * z + cam[9],
        cam[3] * x + cam[4] * y + cam[5] * z + cam[10],
        cam[6] * x + cam[7] * y + cam[8] * z + cam[11],
    )


@inlined
def turned(cam, r00, r01, r02, r10, r11, r12, r20, r21, r22):
    """W R, row by row."""
    return (
        cam[0] * r00 + cam[1] * r10 + cam[2] * r20,
        cam[0] * r01 + cam[1] * r11 + cam[2] * r21,
        cam[0] * r02 + cam[1] * r12 + cam[2] * r22,
        cam[3] * r00 + cam[4] * r10 + cam[5] * r20,
        cam[3] * r01 + cam[4] * r11 + cam[5] * r21,
        cam[3] * r02 + cam[4] * r12 + cam[5] * r22,
        cam[6] * r00 + cam[7] * r10 + cam[8] * r20,
        cam[6] * r01 + cam[7] * r11 + cam[8] * r21,
        cam[6] * r02 + cam[7] * r12 + cam[8] * r22,
    )


@inlined
def clamped(xz, centre, focal, size):
    """x/z limited to the image enlarged by 0.3 of half its field of view on each side (gsplat)."""
    margin = float32(0.15) * size / focal
    return min(max(xz, -centre / focal - margin), (size - centre) / focal + margin)


@inlined
def camera_centre(cam):
    """-Wᵀ t."""
    return (
        -(cam[0] * cam[9] + cam[3] * cam[10] + cam[6] * cam[11]),
        -(cam[1] * cam[9] + cam[4] * cam[10] + cam[7] * cam[11]),
        -(cam[2] * cam[9] + cam[5] * cam[10] + cam[8] * cam[11]),
    )


@part
def _sixteen(means, quats, scales, opacities, features, starts, degree, cam, width, height, splats):
    """`project_forward` of sixteen Gaussians: addresses of the first one's rows. Of `features` only if degree >= 0."""
    one, half, zero = float32(1.0), float32(0.5), broadcast(float32(0.0))
    eps2d, near, far = cam[EPS2D], cam[NEAR], cam[FAR]
    mx, my, mz = transpose_threes(load(means, 0), load(means, 16), load(means, 32))
    x, y, z = camera_space(cam, mx, my, mz)
    opacity = load(opacities, 0)
    power = math.log(max(opacity, float32(1e-20)) / cam[LEAST_ALPHA])
    visible = (z > near) & (z < far) & (power > float32(0.0))
    if movemask(visible) == 0:
        for k in range(LANES):
            put_number(splats, int64(k * SPLAT_WIDTH + POWER), float32(-1.0))
        return
    qw, qx, qy, qz, _ = unit(*transpose(load(quats, 0), load(quats, 16), load(quats, 32), load(quats, 48)))
    n00, n01, n02, n10, n11, n12, n20, n21, n22 = turned(cam, *rotation(qw, qx, qy, qz))
    # B = W R S, so that the camera-space covariance is B Bᵀ
    s0, s1, s2 = transpose_threes(load(scales, 0), load(scales, 16), load(scales, 32))
    b20, b21, b22 = n20 * s0, n21 * s1, n22 * s2
    iz = one / z
    jx, jy = cam[FX] * iz, cam[FY] * iz
    jxz = jx * (-clamped(x * iz, cam[CX], cam[FX], width))
    jyz = jy * (-clamped(y * iz, cam[CY], cam[FY], height))
    # rows of J B
    p0, p1, p2 = fma(jxz, b20, jx * n00 * s0), fma(jxz, b21, jx * n01 * s1), fma(jxz, b22, jx * n02 * s2)
    q0, q1, q2 = fma(jyz, b20, jy * n10 * s0), fma(jyz, b21, jy * n11 * s1), fma(jyz, b22, jy * n12 * s2)
    pp, qq = p0 * p0 + p1 * p1 + p2 * p2, q0 * q0 + q1 * q1 + q2 * q2
    m00, m11, m01 = pp + eps2d, qq + eps2d, p0 * q0 + p1 * q1 + p2 * q2
    # |p × q|² + eps (|p|² + |q|²) + eps²: m00 m11 - m01² without its cancellation in thin ellipses
    c0, c1, c2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
    det = c0 * c0 + c1 * c1 + c2 * c2 + eps2d * (pp + qq + eps2d)
    u, v = fma(jx, x, cam[CX]), fma(jy, y, cam[CY])
    ex, ey = math.sqrt(float32(2.0) * power * m00), math.sqrt(float32(2.0) * power * m11)
    visible = visible & (det > float32(0.0)) & (det < float32(1e37))
    visible = visible & (u + ex >= half) & (u - ex <= width - half)
    visible = visible & (v + ey >= half) & (v - ey <= height - half)
    inv, red, green, blue = one / det, zero, zero, zero
    if degree >= 0 and movemask(visible) != 0:
        ox, oy, oz = camera_centre(cam)
        dx, dy, dz = mx - ox, my - oy, mz - oz
        norm = one / math.sqrt(dx * dx + dy * dy + dz * dz)
        red, green, blue = colour(features, starts, degree, dx * norm, dy * norm, dz * norm)
    power = select(visible, power, float32(-1.0))
    r11, l22 = math.sqrt(det / (float32(SQUARES) * m11)), math.sqrt(float32(SQUARES) / m11)
    record = (
        u, v, m11 * inv, -m01 * inv, m00 * inv, opacity, red, green,
        blue, zero, z, ey, ex, power, r11, l22,
    )  # as layout.py says  # fmt: skip
    store_rows(splats, int64(0), record)


@inlined
def copy(source, target, count):
    """`count` float32 from one address to another."""
    for k in range(count):
        put_number(target, int64(k), number(source, int64(k)))


@shared
def project_forward(
    worker, workers, means, quats, scales, opacities, features, degree, cam, width, height, splats
):
    """Fill `splats` [N, SPLAT_WIDTH]; what lies outside, behind or is too faint gets POWER = -1.

    features: [N, K, 3] SH coefficients where degree >= 0, else [N, 1, D] plain channels, D <= FEATURES.
    """
    n, wide_row = means.shape[0], int64(features.shape[1] * features.shape[2])
    w, h = float32(width), float32(height)
    camera = unpacked(cam)
    for chunk in range(worker, (n + ROWS - 1) // ROWS, workers):
        begin, end = int64(chunk) * ROWS, min(n, (int64(chunk) + 1) * ROWS)
        starts = np.empty(LANES, np.int32)
        for k in range(LANES):
            starts[k] = k * wide_row
        # The last of all by way of a copy: more is read and written at once than may be there.
        room = np.zeros(LANES * (11 + wide_row + SPLAT_WIDTH) + 1 if end == n else 1, np.float32)
        at = address(room)
        rooms = (at, at + 12 * LANES, at + 28 * LANES, at + 40 * LANES, at + 44 * LANES)
        record = at + 4 * (LANES * (11 + wide_row) + 1)
        for i in range(begin, end, LANES):
            m, q, s = address(means) + 12 * i, address(quats) + 16 * i, address(scales) + 12 * i
            o, f = address(opacities) + 4 * i, address(features) + 4 * wide_row * i
            here = address(splats) + 4 * SPLAT_WIDTH * i
            if i + LANES < n:
                _sixteen(m, q, s, o, f, address(starts), degree, camera, w, h, here)
            else:
                rest = n - i
                copy(m, rooms[0], 3 * rest)
                copy(q, rooms[1], 4 * rest)
                copy(s, rooms[2], 3 * rest)
                copy(o, rooms[3], rest)
                copy(f, rooms[4], wide_row * rest)
                _sixteen(
                    rooms[0], rooms[1], rooms[2], rooms[3], rooms[4], address(starts), degree, camera, w, h,
                    record,
                )  # fmt: skip
                copy(record, here, SPLAT_WIDTH * rest)
        keep(room)
        keep(starts)
        if degree < 0:
            for i in range(begin, end):
                for k in range(min(FEATURES, features.shape[2])):
                    splats[i, FEAT + k] = features[i, 0, k]


def empty_splats(n: int) -> np.ndarray:
    """Storage for n projected Gaussians, each in a cache line of its own."""
    return Buffers().take("splats", (n, SPLAT_WIDTH))
