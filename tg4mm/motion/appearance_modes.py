"""Appearance that changes with the motion (gloss, shadows, reflections), in the motion's own modes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

# Largest change of a Gaussian's colour, display-referred. The change is linear only as far as the capture shows it;
# magnified, real appearance saturates (a highlight that has left does not get darker), so it is limited smoothly.
LIMIT = 0.1
_SH_0 = 1 / (2 * math.sqrt(math.pi))  # the constant spherical harmonic: coefficient to colour


@dataclass(frozen=True)
class AppearanceModes:
    """Σ_r c_r(t) shapes[r], with c_r(t) = Σ_k Re[series[k, r] g_k(t)] and the gains g_k of the motion's own modes.

    A few fields and their temporal components, in place of a phasor per Gaussian and frequency: a tenth of the memory.
    """

    shapes: np.ndarray  # [R, N, K, 3] float32, changes of the coefficients of spherical harmonics, K = 1 or 4
    series: np.ndarray  # [F, R] complex128, one row for each frequency of the motion

    def coefficients(self, gains: np.ndarray) -> np.ndarray:
        """[R] float32: c_r for gains [F] complex, magnification included."""
        return np.asarray((np.asarray(gains) @ self.series).real, np.float32)

    def selected(self, keep: np.ndarray) -> AppearanceModes:
        """Only the modes `keep` [F] bool."""
        return replace(self, series=self.series[keep])

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Two [F] bool: whether the real part of mode k, its imaginary part, changes any colour."""
        return self.series.real.any(axis=1), self.series.imag.any(axis=1)

    def fits(self, n_frequencies: int, sh: tuple[int, ...]) -> bool:
        """Whether shapes and types match a motion of so many frequencies and spherical harmonics [N, K', 3]."""
        if self.shapes.ndim != 4 or self.series.shape != (n_frequencies, len(self.shapes)):
            return False
        if self.shapes.dtype != np.float32 or self.series.dtype != np.complex128:
            return False
        _, n, count, channels = self.shapes.shape
        return (n, channels) == (sh[0], 3) and count in (1, 4) and count <= sh[1]


def apply_appearance(sh: Tensor, shapes: Tensor, coefficients: Tensor) -> Tensor:
    """Spherical harmonics [N, K', 3] with Σ_r coefficients[r] shapes[r] added to the first K ≤ K' coefficients.

    shapes [R, N, K, 3], coefficients [R]. The size s of a Gaussian's change, its norm over channels and coefficients in
    colours, becomes LIMIT · tanh(s / LIMIT).
    """
    change = torch.tensordot(coefficients, shapes, dims=1)
    size = torch.linalg.vector_norm(change.flatten(1), dim=1) * (_SH_0 / LIMIT)
    change = change * (torch.tanh(size) / size.clamp_min(1e-6))[:, None, None]
    out = sh.clone()
    out[:, : change.shape[1]] += change
    return out
