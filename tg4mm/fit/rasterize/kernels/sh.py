"""Colours by real spherical harmonics to degree 3, in 3DGS's order and signs, and their gradient.

Of sixteen Gaussians at a time (`vector.py`).
"""

from numba import float32, int64

from tg4mm.fit.rasterize.kernels.compiled import inlined
from tg4mm.fit.rasterize.simd.memory import load, load_first, number, store, store_first
from tg4mm.fit.rasterize.simd.rows import columns, cycled, load_columns, store_rows, thrice, transpose_threes
from tg4mm.fit.rasterize.simd.vector import LANES, broadcast, fma

ROOM = (2 * LANES + 3) * LANES  # float32 that the gradient of sixteen Gaussians needs beside their own

C0 = float32(0.28209479177387814)
C1 = float32(0.4886025119029199)
C20 = float32(1.0925484305920792)
C21 = float32(0.31539156525252005)
C22 = float32(0.5462742152960396)
C30 = float32(0.5900435899266435)
C31 = float32(2.890611442640554)
C32 = float32(0.4570457994644658)
C33 = float32(0.3731763325901154)
C34 = float32(1.445305721320277)


@inlined
def basis(degree, x, y, z):
    """The 16 basis values of the unit directions (x, y, z); 0 above the degree."""
    zero = broadcast(float32(0.0))
    b1, b2, b3, b4, b5, b6, b7, b8 = zero, zero, zero, zero, zero, zero, zero, zero
    b9, b10, b11, b12, b13, b14, b15 = zero, zero, zero, zero, zero, zero, zero
    xx, yy, zz = x * x, y * y, z * z
    if degree > 0:
        b1, b2, b3 = -C1 * y, C1 * z, -C1 * x
    if degree > 1:
        b4, b5, b7 = C20 * x * y, -C20 * y * z, -C20 * x * z
        b6, b8 = C21 * (float32(2.0) * zz - xx - yy), C22 * (xx - yy)
    if degree > 2:
        b9 = -C30 * y * (float32(3.0) * xx - yy)
        b10 = C31 * x * y * z
        b11 = -C32 * y * (float32(4.0) * zz - xx - yy)
        b12 = C33 * z * (float32(2.0) * zz - float32(3.0) * xx - float32(3.0) * yy)
        b13 = -C32 * x * (float32(4.0) * zz - xx - yy)
        b14 = C34 * z * (xx - yy)
        b15 = -C30 * x * (xx - float32(3.0) * yy)
    return broadcast(C0), b1, b2, b3, b4, b5, b6, b7, b8, b9, b10, b11, b12, b13, b14, b15


@inlined
def basis_vjp(degree, x, y, z, v):
    """Gradient by (x, y, z) of Σ v[k] · basis[k], the formulas above taken as polynomials; v: 16 vectors."""
    vx, vy, vz = broadcast(float32(0.0)), broadcast(float32(0.0)), broadcast(float32(0.0))
    two, three, six, eight = float32(2.0), float32(3.0), float32(6.0), float32(8.0)
    xx, yy, zz = x * x, y * y, z * z
    if degree > 0:
        vx, vy, vz = -C1 * v[3], -C1 * v[1], C1 * v[2]
    if degree > 1:
        vx = vx + C20 * (y * v[4] - z * v[7]) - two * C21 * x * v[6] + two * C22 * x * v[8]
        vy = vy + C20 * (x * v[4] - z * v[5]) - two * C21 * y * v[6] - two * C22 * y * v[8]
        vz = vz - C20 * (y * v[5] + x * v[7]) + float32(4.0) * C21 * z * v[6]
    if degree > 2:
        vx = vx - six * C30 * x * y * v[9] + C31 * y * z * v[10] + two * C32 * x * y * v[11]
        vx = vx - six * C33 * x * z * v[12] - C32 * (float32(4.0) * zz - three * xx - yy) * v[13]
        vx = vx + two * C34 * x * z * v[14] - three * C30 * (xx - yy) * v[15]
        vy = vy - three * C30 * (xx - yy) * v[9] + C31 * x * z * v[10]
        vy = vy - C32 * (float32(4.0) * zz - xx - three * yy) * v[11] - six * C33 * y * z * v[12]
        vy = vy + two * C32 * x * y * v[13] - two * C34 * y * z * v[14] + six * C30 * x * y * v[15]
        vz = vz + C31 * x * y * v[10] - eight * C32 * y * z * v[11]
        vz = vz + C33 * (six * zz - three * xx - three * yy) * v[12] - eight * C32 * x * z * v[13]
        vz = vz + C34 * (xx - yy) * v[14]
    return vx, vy, vz


@inlined
def _add(c0, c1, c2, value, f0, f1, f2):
    """A basis value's share of three colours."""
    return fma(value, f0, c0), fma(value, f1, c1), fma(value, f2, c2)


@inlined
def colour(features, starts, degree, x, y, z):
    """Colours of sixteen Gaussians by their SH coefficients, in the unit directions (x, y, z); not below 0.

    features: address of the first one's [K, 3]; starts: where each begins. Of the last one number more is read than
    degrees 0 and 2 need.
    """
    v = basis(degree, x, y, z)
    b0, b1, b2, b3 = columns(features, starts, int64(0))
    c0, c1, c2 = _add(float32(0.5), float32(0.5), float32(0.5), v[0], b0, b1, b2)
    if degree > 0:
        b4, b5, b6, b7 = columns(features, starts, int64(4))
        c0, c1, c2 = _add(c0, c1, c2, v[1], b3, b4, b5)
        b0, b1, b2, b3 = columns(features, starts, int64(8))
        c0, c1, c2 = _add(c0, c1, c2, v[2], b6, b7, b0)
        c0, c1, c2 = _add(c0, c1, c2, v[3], b1, b2, b3)
    if degree > 1:
        b0, b1, b2, b3 = columns(features, starts, int64(12))
        c0, c1, c2 = _add(c0, c1, c2, v[4], b0, b1, b2)
        b4, b5, b6, b7 = columns(features, starts, int64(16))
        c0, c1, c2 = _add(c0, c1, c2, v[5], b3, b4, b5)
        b0, b1, b2, b3 = columns(features, starts, int64(20))
        c0, c1, c2 = _add(c0, c1, c2, v[6], b6, b7, b0)
        c0, c1, c2 = _add(c0, c1, c2, v[7], b1, b2, b3)
        b4, b5, b6, b7 = columns(features, starts, int64(24))
        c0, c1, c2 = _add(c0, c1, c2, v[8], b4, b5, b6)
        if degree > 2:
            b0, b1, b2, b3 = columns(features, starts, int64(28))
            c0, c1, c2 = _add(c0, c1, c2, v[9], b7, b0, b1)
            b4, b5, b6, b7 = columns(features, starts, int64(32))
            c0, c1, c2 = _add(c0, c1, c2, v[10], b2, b3, b4)
            c0, c1, c2 = _add(c0, c1, c2, v[11], b5, b6, b7)
            b0, b1, b2, b3 = columns(features, starts, int64(36))
            c0, c1, c2 = _add(c0, c1, c2, v[12], b0, b1, b2)
            b4, b5, b6, b7 = columns(features, starts, int64(40))
            c0, c1, c2 = _add(c0, c1, c2, v[13], b3, b4, b5)
            b0, b1, b2, b3 = columns(features, starts, int64(44))
            c0, c1, c2 = _add(c0, c1, c2, v[14], b6, b7, b0)
            c0, c1, c2 = _add(c0, c1, c2, v[15], b1, b2, b3)
    zero = float32(0.0)
    return max(c0, zero), max(c1, zero), max(c2, zero)


@inlined
def _three_vectors(place, degree, used):
    """A Gaussian's first `used` numbers of 48."""
    if degree > 2:
        return load(place, int64(0)), load(place, int64(LANES)), load(place, int64(2 * LANES))
    zero = broadcast(float32(0.0))
    return load_first(place, int64(0), used), load_first(place, int64(LANES), used - LANES), zero


@inlined
def colour_vjp(features, v_features, width, degree, x, y, z, g0, g1, g2, room):
    """Add the gradient by the SH coefficients of sixteen Gaussians; return that by their unit directions (x, y, z).

    A Gaussian at a time, its coefficients side by side. features, v_features: addresses of the first one's, `width`
    numbers each. room: address of `ROOM` float32.
    """
    by_basis, colours = room + 4 * LANES * LANES, room + 8 * LANES * LANES
    store_rows(room, int64(0), basis(degree, x, y, z))
    store(colours, int64(0), g0)
    store(colours, int64(LANES), g1)
    store(colours, int64(2 * LANES), g2)
    used = int64(3 * (degree + 1) * (degree + 1))
    for n in range(LANES):
        f, v_f = features + 4 * width * n, v_features + 4 * width * n
        b0, b1, b2 = thrice(load(room, int64(n * LANES)))
        c0, c1, c2 = cycled(
            number(colours, int64(n)),
            number(colours, int64(LANES + n)),
            number(colours, int64(2 * LANES + n)),
        )
        f0, f1, f2 = _three_vectors(f, degree, used)
        s0, s1, s2 = transpose_threes(f0 * c0, f1 * c1, f2 * c2)
        store(by_basis, int64(n * LANES), s0 + s1 + s2)
        v0, v1, v2 = _three_vectors(v_f, degree, used)
        v0, v1, v2 = fma(b0, c0, v0), fma(b1, c1, v1), fma(b2, c2, v2)
        if degree > 2:
            store(v_f, int64(0), v0)
            store(v_f, int64(LANES), v1)
            store(v_f, int64(2 * LANES), v2)
        else:
            store_first(v_f, int64(0), used, v0)
            store_first(v_f, int64(LANES), used - LANES, v1)
    hx, hy, hz = basis_vjp(degree, x, y, z, load_columns(by_basis, int64(0)))
    along = hx * x + hy * y + hz * z
    return hx - along * x, hy - along * y, hz - along * z
