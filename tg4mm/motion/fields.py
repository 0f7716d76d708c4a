"""Phasors of K modes as few real fields: what a motion holds, however many modes it is spread over.

m_k = Σ_r series[k, r] fields[r] with R ≤ 2K fields. A fit finds few temporal components, so that its modes, one for
each bin of the record's Fourier transform, have as many fields; components that hold nothing have none.
"""

from __future__ import annotations

import numpy as np

from tg4mm.motion.modes import ModalMotion

ROUNDING = 1e-6  # of the motion's rms: what float32 does not hold
_AT_ONCE = 8192  # Gaussians, so that no second copy of all phasors in float64 is held


def fields_of(motion: ModalMotion, tolerance: float = ROUNDING) -> tuple[np.ndarray, np.ndarray]:
    """Fields [R, N, 6] float32, by falling strength, and series [K, R] complex128 of a motion's phasors.

    Fields: displacement (scene units) and rotation vector (radians). They are the principal components of the phasors'
    real and imaginary parts (Eckart & Young 1936), displacement and rotation each over its own rms; those of an rms of
    at most `tolerance` of the strongest one's are left out.
    """
    k, n = motion.displacement.shape[:2]
    sizes = np.array([_rms(motion.displacement), _rms(motion.rotation)])
    weights = np.divide(1, sizes, out=np.zeros(2), where=sizes > 0).repeat(3)
    products = np.zeros((2 * k, 2 * k))
    for start in range(0, n, _AT_ONCE):
        rows = (_rows(motion, slice(start, start + _AT_ONCE)) * weights).reshape(
            2 * k, 6 * min(_AT_ONCE, n - start)
        )
        products += rows @ rows.T
    power, vectors = np.linalg.eigh(products)
    u = vectors[:, np.flatnonzero(power > power.max(initial=0) * tolerance**2)[::-1]]
    fields = np.empty((u.shape[1], n, 6), np.float32)
    for start in range(0, n, _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        fields[:, some] = np.tensordot(u.T, _rows(motion, some), axes=1)
    return fields, np.ascontiguousarray(u[:k] + 1j * u[k:])


def _rms(phasors: np.ndarray) -> float:
    """0 where nothing moves."""
    return float(np.sqrt(np.mean(np.abs(phasors) ** 2, dtype=np.float64))) if phasors.size else 0.0


def _rows(motion: ModalMotion, some: slice) -> np.ndarray:
    """[2K, n, 6] float64: real parts, then imaginary parts, of displacement and rotation."""
    both = np.concatenate([motion.displacement[:, some], motion.rotation[:, some]], axis=2)
    return np.concatenate([both.real, both.imag]).astype(np.float64)
