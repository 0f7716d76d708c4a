"""Positions of the Gaussians at a time and a magnification: the numpy reference of x(t, α)."""

import math

import numpy as np

from ..errors import SplatFileError
from .model import SplatFile


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
