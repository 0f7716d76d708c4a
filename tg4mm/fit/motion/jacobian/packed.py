"""The Jacobian of projection: one 8 × 6 block a Gaussian, of its splat by displacement and rotation; and products.

Blocks are stored without their zeros.
"""

import numpy as np
from numba import float32, int64

from tg4mm.fit.rasterize.kernels import linearised
from tg4mm.fit.rasterize.kernels.compiled import inlined, kernel, shared
from tg4mm.fit.rasterize.kernels.layout import SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import ROWS
from tg4mm.fit.rasterize.kernels.project_backward import backward_rows
from tg4mm.fit.rasterize.kernels.tiles import aligned
from tg4mm.fit.rasterize.simd.lanes import half_sums_of_eight, load_eight, load_twice, store_eight
from tg4mm.fit.rasterize.simd.memory import load, number, prefetch, store
from tg4mm.fit.rasterize.simd.vector import LANES, broadcast, fma

DOF = 6  # displacement (scene units) and rotation vector (radians, world axes)
COLUMNS = 8  # of a splat: mean, conic, colour
_CONIC, _COLOUR = slice(2, 5), 5
_PACKED = 36  # three rows of eight, three of three and a zero
_ROTATION = 24 - 2  # first row of rotation, shifted so that the conic's columns lie in lanes 2 to 4
_PREFETCH = 24  # pairs prefetched ahead of their use
_CHUNK = 256  # Gaussians a thread takes at a time
_CONIC_LANES = np.array([2 <= lane < 5 for lane in range(LANES)], np.float32)  # 1 there, else 0


def pack(jacobian: np.ndarray) -> np.ndarray:
    """Return [n, 8, 6] -> [36 n + 16] float32. Rows of rotation must be 0 but for the conic."""
    n = len(jacobian)
    out = np.zeros(_PACKED * n + LANES, np.float32)
    rows = out[: _PACKED * n].reshape(n, _PACKED)
    rows[:, :24].reshape(n, 3, COLUMNS)[:] = jacobian[:, :, :3].transpose(0, 2, 1)
    rows[:, 24:].reshape(n, 3, 4)[:, :, :3] = jacobian[:, _CONIC, 3:].transpose(0, 2, 1)
    return out


def unpack(values: np.ndarray) -> np.ndarray:
    """The inverse of `pack`."""
    rows = values[:-LANES].reshape(-1, _PACKED)
    out = np.zeros((len(rows), COLUMNS, DOF), np.float32)
    out[:, :, :3] = rows[:, :24].reshape(-1, 3, COLUMNS).transpose(0, 2, 1)
    out[:, _CONIC, 3:] = rows[:, 24:].reshape(-1, 3, 4)[:, :, :3].transpose(0, 2, 1)
    return out


def mean_rows_as_colours(values: np.ndarray) -> np.ndarray:
    """Packed blocks whose first two colour rows are the given blocks' mean rows; all else is 0."""
    rows, out = values[:-LANES].reshape(-1, _PACKED), np.zeros_like(values)
    to = out[:-LANES].reshape(-1, _PACKED)[:, :24].reshape(-1, 3, COLUMNS)
    to[..., _COLOUR : _COLOUR + 2] = rows[:, :24].reshape(-1, 3, COLUMNS)[..., :2]
    return out


def mean_rows(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of the mean's x and y (pixels) by displacement: [n, 3] each, views of `values`."""
    of_displacement = values[:-LANES].reshape(-1, _PACKED)[:, :24].reshape(-1, 3, COLUMNS)
    return of_displacement[..., 0], of_displacement[..., 1]


@shared
def _jvp(worker, workers, count, values, rows, conic_lanes, motions, shape, d_splats):
    n_motions, n = shape
    for chunk in range(worker, (count + _CHUNK - 1) // _CHUNK, workers):
        conic = load(conic_lanes, int64(0))
        for k in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            i, at = int64(rows[k]), int64(k) * _PACKED
            j0, j1, j2 = load(values, at), load(values, at + 8), load(values, at + 16)
            at += _ROTATION
            t0, t1, t2 = load(values, at), load(values, at + 4), load(values, at + 8)
            for r in range(n_motions):
                m = (r * n + i) * DOF
                shifted = fma(
                    j0, number(motions, m), fma(j1, number(motions, m + 1), j2 * number(motions, m + 2))
                )
                m += 3
                rotated = fma(
                    t0, number(motions, m), fma(t1, number(motions, m + 1), t2 * number(motions, m + 2))
                )
                store_eight(d_splats, (i * n_motions + r) * COLUMNS, fma(rotated, conic, shifted))


@inlined
def _sum_pairs(v_pairs, slots, first, last, width, at, are_two):
    """Sum over a Gaussian's pairs of one motion's cotangents, at `at` of their rows, or of two: one in each half."""
    total, end = broadcast(float32(0.0)), len(slots) - 1
    for slot in range(first, last):
        prefetch(v_pairs, int64(slots[min(slot + _PREFETCH, end)]) * width + at)
        place = int64(slots[slot]) * width + at
        total = total + (load(v_pairs, place) if are_two else load_eight(v_pairs, place))
    return total


@kernel
def _vjp_range(first, last, values, rows, conic_lanes, pairs, shape, v_motions):
    n_motions, n = shape
    starts, slots, v_pairs = pairs
    conic, nothing = load_twice(conic_lanes, int64(0)), broadcast(float32(0.0))
    width = int64(n_motions * COLUMNS)
    room = aligned(LANES)
    for k in range(first, last):
        i, at = int64(rows[k]), int64(k) * _PACKED
        for r in range(0, n_motions, 2):
            are_two = r + 1 < n_motions
            total = _sum_pairs(v_pairs, slots, starts[k], starts[k + 1], width, int64(r * COLUMNS), are_two)
            of_conic, rotation = total * conic, at + _ROTATION
            sums = half_sums_of_eight(
                load_twice(values, at) * total,
                load_twice(values, at + 8) * total,
                load_twice(values, at + 16) * total,
                load_twice(values, rotation) * of_conic,
                load_twice(values, rotation + 4) * of_conic,
                load_twice(values, rotation + 8) * of_conic,
                nothing,
                nothing,
            )
            store(room, int64(0), sums)
            for half in range(2 if are_two else 1):
                m = ((r + half) * n + i) * DOF
                for d in range(DOF):
                    v_motions[m + d] += room[COLUMNS * half + d]


@shared
def _vjp(worker, workers, count, values, rows, conic_lanes, pairs, shape, v_motions):
    for chunk in range(worker, (count + _CHUNK - 1) // _CHUNK, workers):
        last = min(count, (chunk + 1) * _CHUNK)
        _vjp_range(chunk * _CHUNK, last, values, rows, conic_lanes, pairs, shape, v_motions)


def jvp_rows(values: np.ndarray, rows: np.ndarray, motions: np.ndarray, d_splats: np.ndarray) -> None:
    """Motions [R, N, DOF] -> d_splats [N, R, 8], written for the Gaussians `rows` [n] with packed blocks `values`."""
    _jvp(len(rows), values, rows, _CONIC_LANES, motions.reshape(-1), motions.shape[:2], d_splats.reshape(-1))


def vjp_rows(
    values: np.ndarray,
    rows: np.ndarray,
    starts: np.ndarray,
    slots: np.ndarray,
    v_pairs: np.ndarray,
    v_motions: np.ndarray,
) -> None:
    """The transpose: adds to `v_motions` [R, N, DOF] from cotangents of tile–Gaussian pairs [P, R, 8].

    Those of row k are v_pairs[slots[starts[k] … starts[k + 1] − 1]].
    """
    pairs = starts, slots, v_pairs.reshape(-1)
    _vjp(len(rows), values, rows, _CONIC_LANES, pairs, v_motions.shape[:2], v_motions.reshape(-1))


@kernel
def _of_some(means, quats, scales, sh, degree, camera, width, height, splats, columns, out):
    n = len(means)
    v_splats = np.zeros((n, SPLAT_WIDTH), np.float32)
    v_means, v_quats = np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    v_scales, v_opacities = np.zeros((n, 3), np.float32), np.zeros(n, np.float32)
    v_sh, half = np.zeros(sh.shape, np.float32), float32(0.5)
    no = n < 0  # not a literal: for each value of it `backward_rows` would be compiled anew
    for c in range(len(columns)):
        v_splats[:, columns[c]] = float32(1.0)
        v_means.fill(float32(0.0))
        v_quats.fill(float32(0.0))
        backward_rows(
            means, quats, scales, sh, degree, camera, width, height, splats, v_splats, no,
            v_means, v_quats, v_scales, v_opacities, v_sh,
        )  # fmt: skip
        v_splats[:, columns[c]] = float32(0.0)
        for i in range(n):
            w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
            vw, vx, vy, vz = v_quats[i, 0], v_quats[i, 1], v_quats[i, 2], v_quats[i, 3]
            for k in range(3):  # a slice's assignment compiles for a second longer
                out[i, c, k] = v_means[i, k]
            # a rotation by small angles θ about the world's axes turns a quaternion q by (0, θ) q / 2
            out[i, c, 3] = half * (w * vx - x * vw + y * vz - z * vy)
            out[i, c, 4] = half * (w * vy - y * vw + z * vx - x * vz)
            out[i, c, 5] = half * (w * vz - z * vw + x * vy - y * vx)


@shared
def _of_all(worker, workers, means, quats, scales, sh, degree, camera, width, height, splats, columns, out):
    n = len(means)
    for chunk in range(worker, (n + ROWS - 1) // ROWS, workers):
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
    """Return [N, 8, DOF] float32: derivative of each Gaussian's mean, conic and colour by displacement and rotation.

    Of Gaussians [N] as `project_forward` takes them and the `splats` it gave for a packed camera and size (width,
    height); 0 for those it found invisible.
    """
    out = np.empty((len(means), COLUMNS, DOF), np.float32)
    _of_all(means, quats, scales, sh, degree, camera, *size, splats, linearised.COLUMNS, out)
    return out
