"""Positions of the Gaussians at a time and a magnification: the numpy reference of x(t, α). The scene in other axes."""

import math
from dataclasses import replace

import numpy as np

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile.model import SplatFile

TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # (x, y, z) becomes (x, z, −y)
_DIRECTIONS = 64  # at which spherical harmonics are compared; 16 would do
_ALIKE = 1e-5  # of the scale: what the axes of a similarity may differ by; float32 matrices hold no less


def mode_gains(freqs_hz: np.ndarray, alpha: float, band: tuple[float, float] | None = None) -> np.ndarray:
    """[M] float64: 1 + α·g_k, with g_k = 1 for low ≤ f_k ≤ high, else 0; without a band g_k = 1 for all."""
    if not math.isfinite(alpha):
        raise SplatFileError(f"alpha is {alpha}; expected a finite number")
    if band is None:
        return np.full(len(freqs_hz), 1.0 + alpha)
    low, high = band
    if not 0 <= low < high < math.inf:
        raise SplatFileError(f"band ({low:g}, {high:g}) Hz; expected 0 ≤ low < high")
    return 1.0 + alpha * ((freqs_hz >= low) & (freqs_hz <= high))


def positions_at(
    splat: SplatFile, t: float, alpha: float = 0.0, band: tuple[float, float] | None = None
) -> np.ndarray:
    """[N, 3] float64 scene units: x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)].

    t in timesteps (fractions allowed), alpha as in [TG4MM] Eq. (9), band in Hz with both ends inside.
    """
    return splat.means + _summed(splat, splat.displacement, t, alpha, band)


def rotations_at(
    splat: SplatFile, t: float, alpha: float = 0.0, band: tuple[float, float] | None = None
) -> np.ndarray:
    """[N, 4] float64 unit quaternions wxyz: exp(r(t, α)) · q, r the rotation vector (world axes, radians).

    r(t, α) = Σ_k (1 + α·g_k) Re[ρ_k exp(i 2π f_k t / fps)], ρ_k the rotation phasor of mode k.
    """
    rest = splat.quats / np.linalg.norm(splat.quats.astype(np.float64), axis=1, keepdims=True)
    vector = _summed(splat, splat.rotation, t, alpha, band)
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    # np.sinc(x) is sin(πx)/(πx): sin(angle/2)/angle without a division by zero
    turn = np.concatenate([np.cos(angle / 2), vector * np.sinc(angle / (2 * np.pi)) / 2], axis=1)
    return quat_product(turn, rest)


def _summed(
    splat: SplatFile, phasors: np.ndarray, t: float, alpha: float, band: tuple[float, float] | None
) -> np.ndarray:
    """Σ_k (1 + α·g_k) Re[phasor_k exp(i 2π f_k t / fps)]: phasors [M, N, 3] → [N, 3] float64."""
    gains = mode_gains(splat.freqs_hz, alpha, band)
    if not splat.n_modes:
        return np.zeros(phasors.shape[1:])
    weights = gains * np.exp(2j * np.pi * splat.freqs_hz * t / splat.fps)
    return sum((w * phasor).real for w, phasor in zip(weights, phasors.astype(np.complex128), strict=True))


def quat_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product of wxyz quaternions [N, 4]: b's rotation first, then a's."""
    aw, av, bw, bv = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    real = aw * bw - (av * bv).sum(axis=1, keepdims=True)
    return np.concatenate([real, aw * bv + bw * av + np.cross(av, bv)], axis=1)


def y_up(splat: SplatFile) -> SplatFile:
    """The same scene, its motion and its colours in axes of which Y points up: turned by −90° about x."""
    return transformed(splat, TURN)


def transformed(splat: SplatFile, linear: np.ndarray, shift: np.ndarray | None = None) -> SplatFile:
    """The scene under x → linear·x + shift: places, sizes, turns, colours, motion and its standard deviations.

    Exact where `linear` [3, 3] turns, mirrors and scales alike in all directions; metres per scene unit change with
    the scale. Else positions, displacements and covariances are exact, colours and the Gaussians' own turns go by the
    nearest rotation, and metres per scene unit, which then depend on the direction, become unknown.
    Raises SplatFileError for a `linear` that flattens the scene.
    """
    linear = np.asarray(linear, np.float64)
    u, stretch, v = np.linalg.svd(linear)
    if not stretch[-1] > 1e-9 * stretch[0]:
        raise SplatFileError(
            f"the scene is scaled by {stretch[-1]:g} along one direction; expected more than 0"
        )
    size, turn = float(np.cbrt(stretch.prod())), u @ v
    proper = turn * np.sign(np.linalg.det(turn))  # of mirrored axes: a Gaussian is its own mirror image
    alike = stretch[0] - stretch[-1] <= _ALIKE * size
    if alike:
        quats, scales = (
            quat_product(quats_of(proper[None]), splat.quats.astype(np.float64)),
            size * splat.scales,
        )
    else:
        quats, scales = _stretched(splat, linear)
    moved = splat.displacement @ linear.T.astype(np.float32)
    deviation = splat.deviation
    if deviation is not None:
        before, after = (np.linalg.norm(d, axis=2) for d in (splat.displacement, moved))
        deviation = deviation * np.where(before > 0, after / np.where(before > 0, before, 1), size)
    metres = splat.unit_scale_m
    return replace(
        splat,
        means=(splat.means @ linear.T + (0 if shift is None else np.asarray(shift))).astype(np.float32),
        quats=quats.astype(np.float32),
        scales=scales.astype(np.float32),
        sh=np.einsum("jk,nkc->njc", harmonics_turn(turn, splat.sh.shape[1]), splat.sh).astype(np.float32),
        displacement=moved,
        rotation=splat.rotation @ proper.T.astype(np.float32),
        deviation=None if deviation is None else deviation.astype(np.float32),
        unit_scale_m=metres / size if metres is not None and alike else None,
    )


def _stretched(splat: SplatFile, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions [N, 4] and scales [N, 3] of the Gaussians under `linear`: axes of A R S (A R S)ᵀ."""
    quats = splat.quats.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    axes, scales, _ = np.linalg.svd(linear @ rotation_matrices(quats) * splat.scales[:, None, :])
    return quats_of(axes * np.linalg.det(axes)[:, None, None]), scales


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """[N, 3, 3] rotations of unit quaternions wxyz [N, 4]."""
    w, x, y, z = quats.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def quats_of(matrices: np.ndarray) -> np.ndarray:
    """[N, 4] unit quaternions wxyz of rotations [N, 3, 3]: the eigenvector of Bar-Itzhack (2000), good at any angle."""
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrices, 0, 2)
    rows = (
        (a + e + i, h - f, c - g, d - b),
        (h - f, a - e - i, b + d, c + g),
        (c - g, b + d, e - a - i, f + h),
        (d - b, c + g, f + h, i - a - e),
    )
    return np.linalg.eigh(np.moveaxis(np.array(rows), 2, 0))[1][:, :, -1]


def harmonics_turn(turn: np.ndarray, count: int) -> np.ndarray:
    """[K, K] float64: what coefficients [K] become when the axes turn by the rotation matrix `turn` [3, 3].

    A colour seen along d is then seen along turn · d: Σ_j (X sh)_j Y_j(turn · d) = Σ_k sh_k Y_k(d). Solved from
    values in many directions, exact to rounding since turning mixes only the harmonics of one degree.
    """
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before, after = harmonics(directions)[:, :count], harmonics(directions @ turn.T)[:, :count]
    return np.linalg.lstsq(after, before, rcond=None)[0]


def harmonics(directions: np.ndarray) -> np.ndarray:
    """[D, 16] float64: the real spherical harmonics of 3DGS (docs/conventions.md) at unit vectors [D, 3]."""
    x, y, z = np.asarray(directions, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    return np.stack(
        [
            np.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        axis=1,
    )
