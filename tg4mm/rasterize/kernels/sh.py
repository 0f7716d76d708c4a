"""Real spherical harmonics to degree 3 in 3DGS's order and signs, with derivatives by the direction."""

from numba import float32, njit

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


@njit(fastmath=True, inline="always")
def basis(degree, x, y, z, out):
    """Write the (degree + 1)² basis values of the unit direction (x, y, z) to `out` [16]."""
    out[0] = C0
    if degree < 1:
        return
    out[1] = -C1 * y
    out[2] = C1 * z
    out[3] = -C1 * x
    if degree < 2:
        return
    xx, yy, zz = x * x, y * y, z * z
    out[4] = C20 * x * y
    out[5] = -C20 * y * z
    out[6] = C21 * (float32(2.0) * zz - xx - yy)
    out[7] = -C20 * x * z
    out[8] = C22 * (xx - yy)
    if degree < 3:
        return
    out[9] = -C30 * y * (float32(3.0) * xx - yy)
    out[10] = C31 * x * y * z
    out[11] = -C32 * y * (float32(4.0) * zz - xx - yy)
    out[12] = C33 * z * (float32(2.0) * zz - float32(3.0) * xx - float32(3.0) * yy)
    out[13] = -C32 * x * (float32(4.0) * zz - xx - yy)
    out[14] = C34 * z * (xx - yy)
    out[15] = -C30 * x * (xx - float32(3.0) * yy)


@njit(fastmath=True, inline="always")
def basis_vjp(degree, x, y, z, v):
    """Gradient by (x, y, z) of Σ v[k] · basis[k], the formulas above taken as polynomials."""
    vx, vy, vz = float32(0.0), float32(0.0), float32(0.0)
    if degree < 1:
        return vx, vy, vz
    vx -= C1 * v[3]
    vy -= C1 * v[1]
    vz += C1 * v[2]
    if degree < 2:
        return vx, vy, vz
    two, three, six, eight = float32(2.0), float32(3.0), float32(6.0), float32(8.0)
    xx, yy, zz = x * x, y * y, z * z
    vx += C20 * (y * v[4] - z * v[7]) - two * C21 * x * v[6] + two * C22 * x * v[8]
    vy += C20 * (x * v[4] - z * v[5]) - two * C21 * y * v[6] - two * C22 * y * v[8]
    vz += -C20 * (y * v[5] + x * v[7]) + float32(4.0) * C21 * z * v[6]
    if degree < 3:
        return vx, vy, vz
    vx += -six * C30 * x * y * v[9] + C31 * y * z * v[10] + two * C32 * x * y * v[11]
    vx += -six * C33 * x * z * v[12] - C32 * (float32(4.0) * zz - three * xx - yy) * v[13]
    vx += two * C34 * x * z * v[14] - three * C30 * (xx - yy) * v[15]
    vy += -three * C30 * (xx - yy) * v[9] + C31 * x * z * v[10]
    vy += -C32 * (float32(4.0) * zz - xx - three * yy) * v[11] - six * C33 * y * z * v[12]
    vy += two * C32 * x * y * v[13] - two * C34 * y * z * v[14] + six * C30 * x * y * v[15]
    vz += C31 * x * y * v[10] - eight * C32 * y * z * v[11]
    vz += C33 * (six * zz - three * xx - three * yy) * v[12] - eight * C32 * x * z * v[13]
    vz += C34 * (xx - yy) * v[14]
    return vx, vy, vz
