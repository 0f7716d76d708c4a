"""The gradient of projection: from projected Gaussians back to the parameters, in one fused pass.

Formulas and names as in `project.py`. No matrix of a Gaussian is kept from the forward pass: making it again is
cheaper than reading it.
"""

import math

import numpy as np
from numba import float32, int64

from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel, part, shared
from tg4mm.fit.rasterize.kernels.layout import CA, CB, CC, FEAT, FEATURES, MX, MY, OP, POWER, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import (
    CX,
    CY,
    FX,
    FY,
    ROWS,
    camera_centre,
    camera_space,
    clamped,
    copy,
    rotation,
    turned,
    unit,
    unpacked,
)
from tg4mm.fit.rasterize.kernels.sh import ROOM, colour_vjp
from tg4mm.fit.rasterize.simd.lanes import load_fours, store_fours
from tg4mm.fit.rasterize.simd.memory import address, keep, load, store
from tg4mm.fit.rasterize.simd.rows import (
    interleave,
    interleave_threes,
    load_columns,
    transpose,
    transpose_threes,
)
from tg4mm.fit.rasterize.simd.vector import LANES, broadcast, movemask, select


@inlined
def _quat_vjp(w, x, y, z, inv, g00, g01, g02, g10, g11, g12, g20, g21, g22):
    """Gradient by the unnormalised quaternion of a loss with gradient g by its rotation matrix."""
    two, four = float32(2.0), float32(4.0)
    vw = two * (x * (g21 - g12) + y * (g02 - g20) + z * (g10 - g01))
    vx = two * (w * (g21 - g12) + y * (g01 + g10) + z * (g02 + g20)) - four * x * (g11 + g22)
    vy = two * (w * (g02 - g20) + x * (g01 + g10) + z * (g12 + g21)) - four * y * (g00 + g22)
    vz = two * (w * (g10 - g01) + x * (g02 + g20) + y * (g12 + g21)) - four * z * (g00 + g11)
    along = vw * w + vx * x + vy * y + vz * z
    return (vw - along * w) * inv, (vx - along * x) * inv, (vy - along * y) * inv, (vz - along * z) * inv


@inlined
def _covariance_vjp(a, b, c, ga, gb, gc, p, q):
    """Gradient by a column (p, q) of P, where M = P Pᵀ + eps and G is the gradient by the conic C = M⁻¹.

    It is -2 C (G (C [p, q])), in this order, vector by vector, not (C G C) [p, q]: along the long axis of a
    thin ellipse C is small beside its own entries, and a product of matrices squares what is lost there.
    """
    y0, y1 = a * p + b * q, b * p + c * q
    z0, z1 = ga * y0 + gb * y1, gb * y0 + gc * y1
    two = float32(-2.0)
    return two * (a * z0 + b * z1), two * (b * z0 + c * z1)


@inlined
def _add_three(at, visible, a, b, c):
    """Add three columns to sixteen rows of three numbers, 0 where not visible."""
    nothing = float32(0.0)
    rows = interleave_threes(
        select(visible, a, nothing), select(visible, b, nothing), select(visible, c, nothing)
    )
    for k in range(3):
        store(at, int64(k * LANES), load(at, int64(k * LANES)) + rows[k])


@inlined
def _add_four(at, width, visible, a, b, c, d):
    """Add four columns to sixteen rows, `width` numbers apart, 0 where not visible."""
    nothing = float32(0.0)
    a, b = select(visible, a, nothing), select(visible, b, nothing)
    c, d = select(visible, c, nothing), select(visible, d, nothing)
    rows = interleave(a, b, c, d)
    for k in range(4):
        place = 4 * k * width
        store_fours(at, place, width, load_fours(at, place, width) + rows[k])


@inlined
def _axis(slope, centre, focal, size, reciprocal, v_slope, g):
    """Return, for an axis of the image, the gradient by the place along it and its share of that by z.

    Through the mean, whose gradient is g, and the Jacobian's entry -focal / z · slope, whose gradient is v_slope and in
    which the slope (x / z, y / z) does not count where it is clamped.
    """
    held = clamped(slope, centre, focal, size)
    step = focal * reciprocal * reciprocal * v_slope
    free, two, one = held == slope, broadcast(float32(2.0)), broadcast(float32(1.0))
    along = focal * reciprocal * g - select(free, step, float32(0.0))
    return along, step * held * select(free, two, one) - focal * reciprocal * slope * g


@part
def _sixteen(given, sums, view, cam, width, height, room):
    """`backward_rows` of sixteen Gaussians: addresses of the first one's rows, inputs and sums."""
    means, quats, scales, features, splats, v_splats = given
    v_means, v_quats, v_scales, v_opacities, v_features = sums
    degree, summed, of_features = view
    one, half, nothing = float32(1.0), float32(0.5), float32(0.0)
    record, v_record = load_columns(splats, int64(0)), load_columns(v_splats, int64(0))
    visible = record[POWER] > nothing
    if movemask(visible) == 0:
        return
    a, b, c = record[CA], record[CB], record[CC]
    gu, gv, go = v_record[MX], v_record[MY], v_record[OP]
    ga, gb, gc = v_record[CA], half * v_record[CB], v_record[CC]
    if summed:
        gu, gv, go = a * gu + b * gv, b * gu + c * gv, go / record[OP]
        ga, gb, gc = -half * ga, -gb, -half * gc
    mx, my, mz = transpose_threes(load(means, int64(0)), load(means, int64(16)), load(means, int64(32)))
    x, y, z = camera_space(cam, mx, my, mz)
    s0, s1, s2 = transpose_threes(load(scales, int64(0)), load(scales, int64(16)), load(scales, int64(32)))
    qw, qx, qy, qz, qinv = unit(
        *transpose(
            load(quats, int64(0)), load(quats, int64(16)), load(quats, int64(32)), load(quats, int64(48))
        )
    )
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(qw, qx, qy, qz)
    # N = W R (columns), B = N S
    n00, n01, n02, n10, n11, n12, n20, n21, n22 = turned(cam, r00, r01, r02, r10, r11, r12, r20, r21, r22)
    iz = one / z
    jx, jy = cam[FX] * iz, cam[FY] * iz
    jxz = -jx * clamped(x * iz, cam[CX], cam[FX], width)
    jyz = -jy * clamped(y * iz, cam[CY], cam[FY], height)
    # P = J B with rows p, q; M = P Pᵀ + eps
    b00, b01, b02 = n00 * s0, n01 * s1, n02 * s2
    b10, b11, b12 = n10 * s0, n11 * s1, n12 * s2
    b20, b21, b22 = n20 * s0, n21 * s1, n22 * s2
    vp0, vq0 = _covariance_vjp(a, b, c, ga, gb, gc, jx * b00 + jxz * b20, jy * b10 + jyz * b20)
    vp1, vq1 = _covariance_vjp(a, b, c, ga, gb, gc, jx * b01 + jxz * b21, jy * b11 + jyz * b21)
    vp2, vq2 = _covariance_vjp(a, b, c, ga, gb, gc, jx * b02 + jxz * b22, jy * b12 + jyz * b22)
    # gradient by B = Jᵀ vP and by the entries of J
    vjx = vp0 * b00 + vp1 * b01 + vp2 * b02
    vjxz = vp0 * b20 + vp1 * b21 + vp2 * b22
    vjy = vq0 * b10 + vq1 * b11 + vq2 * b12
    vjyz = vq0 * b20 + vq1 * b21 + vq2 * b22
    vb00, vb01, vb02 = jx * vp0, jx * vp1, jx * vp2
    vb10, vb11, vb12 = jy * vq0, jy * vq1, jy * vq2
    vb20, vb21, vb22 = jxz * vp0 + jyz * vq0, jxz * vp1 + jyz * vq1, jxz * vp2 + jyz * vq2
    _add_three(
        v_scales,
        visible,
        vb00 * n00 + vb10 * n10 + vb20 * n20,
        vb01 * n01 + vb11 * n11 + vb21 * n21,
        vb02 * n02 + vb12 * n12 + vb22 * n22,
    )
    # by N, then by R = Wᵀ vN
    vn00, vn01, vn02 = vb00 * s0, vb01 * s1, vb02 * s2
    vn10, vn11, vn12 = vb10 * s0, vb11 * s1, vb12 * s2
    vn20, vn21, vn22 = vb20 * s0, vb21 * s1, vb22 * s2
    back = cam[0], cam[3], cam[6], cam[1], cam[4], cam[7], cam[2], cam[5], cam[8]
    by_rotation = turned(back, vn00, vn01, vn02, vn10, vn11, vn12, vn20, vn21, vn22)
    vqw, vqx, vqy, vqz = _quat_vjp(qw, qx, qy, qz, qinv, *by_rotation)
    _add_four(v_quats, int64(4), visible, vqw, vqx, vqy, vqz)
    # position in the camera: through the mean and the Jacobian
    vcx, by_x = _axis(x * iz, cam[CX], cam[FX], width, iz, vjxz, gu)
    vcy, by_y = _axis(y * iz, cam[CY], cam[FY], height, iz, vjyz, gv)
    vcz = by_x + by_y - (vjx * jx + vjy * jy) * iz
    store(v_opacities, int64(0), load(v_opacities, int64(0)) + select(visible, go, nothing))
    vx, vy, vz = broadcast(nothing), broadcast(nothing), broadcast(nothing)  # by the viewing direction
    if degree >= 0:
        ox, oy, oz = camera_centre(cam)
        dx, dy, dz = mx - ox, my - oy, mz - oz
        norm = one / math.sqrt(dx * dx + dy * dy + dz * dz)
        # the clamp at 0 passes no gradient
        g0 = select(visible & (record[FEAT] > nothing), v_record[FEAT], nothing)
        g1 = select(visible & (record[FEAT + 1] > nothing), v_record[FEAT + 1], nothing)
        g2 = select(visible & (record[FEAT + 2] > nothing), v_record[FEAT + 2], nothing)
        dx, dy, dz = (
            select(visible, dx * norm, nothing),
            select(visible, dy * norm, nothing),
            select(visible, dz * norm, nothing),
        )
        vx, vy, vz = colour_vjp(features, v_features, of_features, degree, dx, dy, dz, g0, g1, g2, room)
        vx, vy, vz = vx * norm, vy * norm, vz * norm
    _add_three(
        v_means,
        visible,
        cam[0] * vcx + cam[3] * vcy + cam[6] * vcz + vx,
        cam[1] * vcx + cam[4] * vcy + cam[7] * vcz + vy,
        cam[2] * vcx + cam[5] * vcy + cam[8] * vcz + vz,
    )


@inlined
def _rows_at(arrays, widths, row):
    """Addresses of a row of eleven arrays: addresses of the arrays, and how many float32 a row of each has."""
    return (
        arrays[0] + 4 * widths[0] * row, arrays[1] + 4 * widths[1] * row, arrays[2] + 4 * widths[2] * row,
        arrays[3] + 4 * widths[3] * row, arrays[4] + 4 * widths[4] * row, arrays[5] + 4 * widths[5] * row,
        arrays[6] + 4 * widths[6] * row, arrays[7] + 4 * widths[7] * row, arrays[8] + 4 * widths[8] * row,
        arrays[9] + 4 * widths[9] * row, arrays[10] + 4 * widths[10] * row,
    )  # fmt: skip


@kernel
def backward_rows(
    means, quats, scales, features, degree, cam, width, height, splats, v_splats, summed,
    v_means, v_quats, v_scales, v_opacities, v_features,
):  # fmt: skip
    """`project_backward` of the given rows in one thread. Only the visible rows of `v_splats` count."""
    n, of_features = means.shape[0], int64(features.shape[1] * features.shape[2])
    camera, w, h = unpacked(cam), float32(width), float32(height)
    view = (int64(degree), bool(summed), of_features)
    arrays = (
        address(means), address(quats), address(scales), address(features), address(splats), address(v_splats),
        address(v_means), address(v_quats), address(v_scales), address(v_opacities), address(v_features),
    )  # fmt: skip
    widths = (3, 4, 3, of_features, SPLAT_WIDTH, SPLAT_WIDTH, 3, 4, 3, 1, of_features)
    room = np.empty(ROOM, np.float32)
    full = n - n % LANES
    for i in range(0, full, LANES):
        rows = _rows_at(arrays, widths, i)
        _sixteen(rows[:6], rows[6:], view, camera, w, h, address(room))
    if n > full:  # through a copy: sixteen rows are read and written at once
        most = LANES * max(of_features, int64(SPLAT_WIDTH))
        part = np.zeros((11, most), np.float32)
        at = address(part)
        rows = _rows_at(
            (at, at, at, at, at, at, at, at, at, at, at), (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10), most
        )
        for k in range(11):
            copy(arrays[k] + 4 * widths[k] * full, rows[k], widths[k] * (n - full))
        _sixteen(rows[:6], rows[6:], view, camera, w, h, address(room))
        for k in range(6, 11):
            copy(rows[k], arrays[k] + 4 * widths[k] * full, widths[k] * (n - full))
        keep(part)
    keep(room)
    if degree < 0:
        for i in range(n):
            if splats[i, POWER] > float32(0.0):
                for k in range(min(FEATURES, v_features.shape[2])):
                    v_features[i, 0, k] += v_splats[i, FEAT + k]


@shared
def project_backward(
    worker, workers, means, quats, scales, features, degree, cam, width, height, splats, v_splats, summed,
    v_means, v_quats, v_scales, v_opacities, v_features,
):  # fmt: skip
    """Pull `v_splats` [N, SPLAT_WIDTH] back to the parameters, adding to the v_* arrays.

    summed: `v_splats` contains sums of pairs (layout.py), not yet the gradient by `splats`.
    """
    n = means.shape[0]
    for chunk in range(worker, (n + ROWS - 1) // ROWS, workers):
        a, b = chunk * ROWS, min(n, chunk * ROWS + ROWS)
        backward_rows(
            means[a:b], quats[a:b], scales[a:b], features[a:b], degree, cam, width, height, splats[a:b],
            v_splats[a:b], summed, v_means[a:b], v_quats[a:b], v_scales[a:b], v_opacities[a:b],
            v_features[a:b],
        )  # fmt: skip
