"""Modes as few fields and their series: what a page holds of a motion, however many modes it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tg4mm.motion.modes import ModalMotion

TOLERANCE = 1e-4  # of the motion's rms: weaker fields are left out
_ROWS_AT_ONCE = 8192  # Gaussians, so that no second copy of all phasors in float64 is held


@dataclass(frozen=True)
class MotionFields:
    """m_k = Σ_r series[k, r] fields[r], real fields: the phasors of K modes by R ≤ 2K fields.

    At a time and magnification the motion is Σ_r c_r fields[r], c_r = Σ_k Re[series[k, r] g_k] with the modes' gains
    g_k. Each field's displacement and rotation have a largest size of 1 once divided by `sizes[r]`.
    """

    fields: (
        np.ndarray
    )  # [R, N, 6] float32: displacement in scene units, rotation vector in radians; over `sizes`
    sizes: np.ndarray  # [R, 2] float64: scene units, radians; 0 where a field does not move or not turn
    series: np.ndarray  # [K, R] complex128


def motion_fields(motion: ModalMotion, tolerance: float = TOLERANCE) -> MotionFields:
    """The motion's strongest fields; what is left out has an rms of at most `tolerance` of the motion's, each field.

    The fields are the principal components of the phasors' real and imaginary parts (Eckart and Young 1936), with
    displacement and rotation weighed by their own rms. A motion that a fit found to have few components (motion.md)
    comes back with as many fields, whatever the number of its modes; parts that do not move are no field.
    """
    k, n = motion.displacement.shape[:2]
    weights = np.array([_weight(motion.displacement), _weight(motion.rotation)])
    products = np.zeros((2 * k, 2 * k))
    for start in range(0, n, _ROWS_AT_ONCE):
        rows = _rows(motion, weights, slice(start, start + _ROWS_AT_ONCE)).reshape(2 * k, -1)
        products += rows @ rows.T
    power, vectors = np.linalg.eigh(products)
    keep = np.flatnonzero(power > max(power.max(initial=0) * tolerance**2, 0))[::-1]
    u = vectors[:, keep]
    fields = np.empty((len(keep), n, 6), np.float32)
    for start in range(0, n, _ROWS_AT_ONCE):
        chosen = slice(start, start + _ROWS_AT_ONCE)
        fields[:, chosen] = np.tensordot(u.T, _rows(motion, weights, chosen), axes=1)
    largest = np.abs(fields.reshape(len(keep), n, 2, 3)).max(axis=(1, 3), initial=0)
    unit = np.where(largest > 0, largest, 1).repeat(3, axis=1)
    inverse = np.divide(1, weights, out=np.zeros(2), where=weights > 0)
    return MotionFields(fields / unit[:, None].astype(np.float32), largest * inverse, u[:k] + 1j * u[k:])


def _weight(phasors: np.ndarray) -> float:
    """One over the rms, 0 where nothing moves."""
    rms = float(np.sqrt(np.mean(np.abs(phasors) ** 2, dtype=np.float64))) if phasors.size else 0.0
    return 1 / rms if rms > 0 else 0.0


def _rows(motion: ModalMotion, weights: np.ndarray, chosen: slice) -> np.ndarray:
    """[2K, n, 6] float64: real parts, then imaginary parts, of weighted displacement and rotation."""
    both = np.concatenate([motion.displacement[:, chosen], motion.rotation[:, chosen]], axis=2)
    both = both.astype(np.complex128) * weights.repeat(3)
    return np.concatenate([both.real, both.imag])
