"""The gradient of projection: from projected Gaussians back to the parameters, in one fused pass.

Formulas and names as in `project.py`. No matrix of a Gaussian is kept from the forward pass: making it again is
cheaper than reading it.
"""

import math

import numpy as np
from numba import float32, njit, prange

from tg4mm.rasterize.kernels.compiled import kernel
from tg4mm.rasterize.kernels.layout import CA, CB, CC, FEAT, FEATURES, MX, MY, OP, POWER
from tg4mm.rasterize.kernels.project import CX, CY, FX, FY, ROWS, camera_space, clamped, rotation_of
from tg4mm.rasterize.kernels.sh import basis, basis_vjp


@njit(fastmath=True, inline="always")
def _quat_vjp(w, x, y, z, inv, g00, g01, g02, g10, g11, g12, g20, g21, g22):
    """Gradient by the unnormalised quaternion of a loss with gradient g by its rotation matrix."""
    two, four = float32(2.0), float32(4.0)
    vw = two * (x * (g21 - g12) + y * (g02 - g20) + z * (g10 - g01))
    vx = two * (w * (g21 - g12) + y * (g01 + g10) + z * (g02 + g20)) - four * x * (g11 + g22)
    vy = two * (w * (g02 - g20) + x * (g01 + g10) + z * (g12 + g21)) - four * y * (g00 + g22)
    vz = two * (w * (g10 - g01) + x * (g02 + g20) + y * (g12 + g21)) - four * z * (g00 + g11)
    along = vw * w + vx * x + vy * y + vz * z
    return (vw - along * w) * inv, (vx - along * x) * inv, (vy - along * y) * inv, (vz - along * z) * inv


@njit(fastmath=True, inline="always")
def _covariance_vjp(a, b, c, ga, gb, gc, p, q):
    """Gradient by a column (p, q) of P, where M = P Pᵀ + eps and G is the gradient by the conic C = M⁻¹.

    It is -2 C (G (C [p, q])), in this order, vector by vector, not (C G C) [p, q]: along the long axis of a
    thin ellipse C is small beside its own entries, and a product of matrices squares what is lost there.
    """
    y0, y1 = a * p + b * q, b * p + c * q
    z0, z1 = ga * y0 + gb * y1, gb * y0 + gc * y1
    two = float32(-2.0)
    return two * (a * z0 + b * z1), two * (b * z0 + c * z1)


@njit(fastmath=True, inline="always")
def _pose_share(
    v_pose, i, cam, mx, my, mz, vcx, vcy, vcz, dirx, diry, dirz,
    w00, w01, w02, w10, w11, w12, w20, w21, w22,
):  # fmt: skip
    """Gradient by W and t: through camera-space position, covariance (w..) and the viewing direction.

    The direction starts at the camera centre o = -Wᵀ t, so its share is that of -dir by o.
    """
    tx, ty, tz = cam[9], cam[10], cam[11]
    v_pose[i, 0] = vcx * mx + w00 + tx * dirx
    v_pose[i, 1] = vcx * my + w01 + tx * diry
    v_pose[i, 2] = vcx * mz + w02 + tx * dirz
    v_pose[i, 3] = vcy * mx + w10 + ty * dirx
    v_pose[i, 4] = vcy * my + w11 + ty * diry
    v_pose[i, 5] = vcy * mz + w12 + ty * dirz
    v_pose[i, 6] = vcz * mx + w20 + tz * dirx
    v_pose[i, 7] = vcz * my + w21 + tz * diry
    v_pose[i, 8] = vcz * mz + w22 + tz * dirz
    v_pose[i, 9] = vcx + cam[0] * dirx + cam[1] * diry + cam[2] * dirz
    v_pose[i, 10] = vcy + cam[3] * dirx + cam[4] * diry + cam[5] * dirz
    v_pose[i, 11] = vcz + cam[6] * dirx + cam[7] * diry + cam[8] * dirz


@kernel(fastmath=True)
def backward_rows(
    means, quats, scales, features, degree, with_depth, cam, width, height, splats, v_splats, summed,
    v_means, v_quats, v_scales, v_opacities, v_features, v_pose, with_pose,
):  # fmt: skip
    """`project_backward` of the given rows in one thread. Of `v_splats` only rows that are visible are read."""
    fx, fy, cx, cy = cam[FX], cam[FY], cam[CX], cam[CY]
    ox = -(cam[0] * cam[9] + cam[3] * cam[10] + cam[6] * cam[11])
    oy = -(cam[1] * cam[9] + cam[4] * cam[10] + cam[7] * cam[11])
    oz = -(cam[2] * cam[9] + cam[5] * cam[10] + cam[8] * cam[11])
    w, h = float32(width), float32(height)
    two, half = float32(2.0), float32(0.5)
    sh, v_sh = np.empty(16, np.float32), np.empty(16, np.float32)
    for i in range(means.shape[0]):
        if splats[i, POWER] <= float32(0.0):
            continue
        mx, my, mz = means[i, 0], means[i, 1], means[i, 2]
        x, y, z = camera_space(cam, mx, my, mz)
        r00, r01, r02, r10, r11, r12, r20, r21, r22, qw, qx, qy, qz, qinv = rotation_of(quats, i)
        s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
        # N = W R (columns), B = N S
        n00 = cam[0] * r00 + cam[1] * r10 + cam[2] * r20
        n01 = cam[0] * r01 + cam[1] * r11 + cam[2] * r21
        n02 = cam[0] * r02 + cam[1] * r12 + cam[2] * r22
        n10 = cam[3] * r00 + cam[4] * r10 + cam[5] * r20
        n11 = cam[3] * r01 + cam[4] * r11 + cam[5] * r21
        n12 = cam[3] * r02 + cam[4] * r12 + cam[5] * r22
        n20 = cam[6] * r00 + cam[7] * r10 + cam[8] * r20
        n21 = cam[6] * r01 + cam[7] * r11 + cam[8] * r21
        n22 = cam[6] * r02 + cam[7] * r12 + cam[8] * r22
        iz = float32(1.0) / z
        jx, jy = fx * iz, fy * iz
        tx, ty = clamped(x * iz, cx, fx, w), clamped(y * iz, cy, fy, h)
        jxz, jyz = -jx * tx, -jy * ty
        # P = J B with rows p, q; M = P Pᵀ + eps
        b00, b01, b02 = n00 * s0, n01 * s1, n02 * s2
        b10, b11, b12 = n10 * s0, n11 * s1, n12 * s2
        b20, b21, b22 = n20 * s0, n21 * s1, n22 * s2
        p0, p1, p2 = jx * b00 + jxz * b20, jx * b01 + jxz * b21, jx * b02 + jxz * b22
        q0, q1, q2 = jy * b10 + jyz * b20, jy * b11 + jyz * b21, jy * b12 + jyz * b22
        a, b, c = splats[i, CA], splats[i, CB], splats[i, CC]
        gu, gv, go = v_splats[i, MX], v_splats[i, MY], v_splats[i, OP]
        ga, gb, gc = v_splats[i, CA], half * v_splats[i, CB], v_splats[i, CC]
        if summed:
            gu, gv, go = a * gu + b * gv, b * gu + c * gv, go / splats[i, OP]
            ga, gb, gc = -half * ga, -gb, -half * gc
        vp0, vq0 = _covariance_vjp(a, b, c, ga, gb, gc, p0, q0)
        vp1, vq1 = _covariance_vjp(a, b, c, ga, gb, gc, p1, q1)
        vp2, vq2 = _covariance_vjp(a, b, c, ga, gb, gc, p2, q2)
        # gradient by B = Jᵀ vP and by the entries of J
        vjx = vp0 * b00 + vp1 * b01 + vp2 * b02
        vjxz = vp0 * b20 + vp1 * b21 + vp2 * b22
        vjy = vq0 * b10 + vq1 * b11 + vq2 * b12
        vjyz = vq0 * b20 + vq1 * b21 + vq2 * b22
        vb00, vb01, vb02 = jx * vp0, jx * vp1, jx * vp2
        vb10, vb11, vb12 = jy * vq0, jy * vq1, jy * vq2
        vb20, vb21, vb22 = jxz * vp0 + jyz * vq0, jxz * vp1 + jyz * vq1, jxz * vp2 + jyz * vq2
        v_scales[i, 0] += vb00 * n00 + vb10 * n10 + vb20 * n20
        v_scales[i, 1] += vb01 * n01 + vb11 * n11 + vb21 * n21
        v_scales[i, 2] += vb02 * n02 + vb12 * n12 + vb22 * n22
        # by N, then by R = Wᵀ vN
        vn00, vn01, vn02 = vb00 * s0, vb01 * s1, vb02 * s2
        vn10, vn11, vn12 = vb10 * s0, vb11 * s1, vb12 * s2
        vn20, vn21, vn22 = vb20 * s0, vb21 * s1, vb22 * s2
        vw_, vx_, vy_, vz_ = _quat_vjp(
            qw, qx, qy, qz, qinv,
            cam[0] * vn00 + cam[3] * vn10 + cam[6] * vn20,
            cam[0] * vn01 + cam[3] * vn11 + cam[6] * vn21,
            cam[0] * vn02 + cam[3] * vn12 + cam[6] * vn22,
            cam[1] * vn00 + cam[4] * vn10 + cam[7] * vn20,
            cam[1] * vn01 + cam[4] * vn11 + cam[7] * vn21,
            cam[1] * vn02 + cam[4] * vn12 + cam[7] * vn22,
            cam[2] * vn00 + cam[5] * vn10 + cam[8] * vn20,
            cam[2] * vn01 + cam[5] * vn11 + cam[8] * vn21,
            cam[2] * vn02 + cam[5] * vn12 + cam[8] * vn22,
        )  # fmt: skip
        v_quats[i, 0] += vw_
        v_quats[i, 1] += vx_
        v_quats[i, 2] += vy_
        v_quats[i, 3] += vz_
        # position in the camera: through the mean, the Jacobian (only where it is not clamped) and depth
        iz2 = iz * iz
        vcx, vcy = jx * gu, jy * gv
        vcz = -(fx * x * gu + fy * y * gv) * iz2 - (vjx * jx + vjy * jy) * iz
        if tx == x * iz:
            vcx -= fx * iz2 * vjxz
            vcz += two * fx * tx * iz2 * vjxz
        else:
            vcz += fx * tx * iz2 * vjxz
        if ty == y * iz:
            vcy -= fy * iz2 * vjyz
            vcz += two * fy * ty * iz2 * vjyz
        else:
            vcz += fy * ty * iz2 * vjyz
        if with_depth:
            vcz += v_splats[i, FEAT + FEATURES - 1]
        v_opacities[i] += go
        vmx = cam[0] * vcx + cam[3] * vcy + cam[6] * vcz
        vmy = cam[1] * vcx + cam[4] * vcy + cam[7] * vcz
        vmz = cam[2] * vcx + cam[5] * vcy + cam[8] * vcz
        dirx, diry, dirz = float32(0.0), float32(0.0), float32(0.0)
        if degree >= 0:
            dx, dy, dz = mx - ox, my - oy, mz - oz
            norm = float32(1.0) / math.sqrt(dx * dx + dy * dy + dz * dz)
            ux, uy, uz = dx * norm, dy * norm, dz * norm
            basis(degree, ux, uy, uz, sh)
            # the clamp at 0 passes no gradient
            g0 = v_splats[i, FEAT] if splats[i, FEAT] > float32(0.0) else float32(0.0)
            g1 = v_splats[i, FEAT + 1] if splats[i, FEAT + 1] > float32(0.0) else float32(0.0)
            g2 = v_splats[i, FEAT + 2] if splats[i, FEAT + 2] > float32(0.0) else float32(0.0)
            for k in range((degree + 1) * (degree + 1)):
                v_features[i, k, 0] += sh[k] * g0
                v_features[i, k, 1] += sh[k] * g1
                v_features[i, k, 2] += sh[k] * g2
                v_sh[k] = features[i, k, 0] * g0 + features[i, k, 1] * g1 + features[i, k, 2] * g2
            hx, hy, hz = basis_vjp(degree, ux, uy, uz, v_sh)
            along = hx * ux + hy * uy + hz * uz
            dirx, diry, dirz = (
                (hx - along * ux) * norm,
                (hy - along * uy) * norm,
                (hz - along * uz) * norm,
            )
        else:
            for k in range(min(FEATURES, v_features.shape[2])):
                v_features[i, 0, k] += v_splats[i, FEAT + k]
        v_means[i, 0] += vmx + dirx
        v_means[i, 1] += vmy + diry
        v_means[i, 2] += vmz + dirz
        if with_pose:
            _pose_share(
                v_pose, i, cam, mx, my, mz, vcx, vcy, vcz, dirx, diry, dirz,
                r00 * vn00 + r01 * vn01 + r02 * vn02, r10 * vn00 + r11 * vn01 + r12 * vn02,
                r20 * vn00 + r21 * vn01 + r22 * vn02,
                r00 * vn10 + r01 * vn11 + r02 * vn12, r10 * vn10 + r11 * vn11 + r12 * vn12,
                r20 * vn10 + r21 * vn11 + r22 * vn12,
                r00 * vn20 + r01 * vn21 + r02 * vn22, r10 * vn20 + r11 * vn21 + r12 * vn22,
                r20 * vn20 + r21 * vn21 + r22 * vn22,
            )  # fmt: skip


@kernel(parallel=True, fastmath=True)
def project_backward(
    means, quats, scales, features, degree, with_depth, cam, width, height, splats, v_splats, summed,
    v_means, v_quats, v_scales, v_opacities, v_features, v_pose, with_pose,
):  # fmt: skip
    """Pull `v_splats` [N, SPLAT_WIDTH] back to the parameters, adding to the v_* arrays.

    summed: what `v_splats` holds are sums of pairs (layout.py) and not yet the gradient by `splats`.
    v_pose: [N, 12] each Gaussian's share of the gradient by W (row-major) and t; untouched unless with_pose.
    """
    n = means.shape[0]
    for chunk in prange((n + ROWS - 1) // ROWS):
        a, b = chunk * ROWS, min(n, chunk * ROWS + ROWS)
        backward_rows(
            means[a:b], quats[a:b], scales[a:b], features[a:b], degree, with_depth, cam, width, height,
            splats[a:b], v_splats[a:b], summed, v_means[a:b], v_quats[a:b], v_scales[a:b], v_opacities[a:b],
            v_features[a:b], v_pose[a:b], with_pose,
        )  # fmt: skip
