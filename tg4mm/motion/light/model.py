"""Magnified light: how the colour of every Gaussian changes over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Light:
    """Σ_r c_r(t) shapes[r], with c_r(t) = Σ_k Re[series[k, r] g_k(t)] and the gains g_k of the motion's own modes.

    A few fields and functions of time, not a phasor per Gaussian and frequency: a tenth of the room.
    """

    shapes: np.ndarray  # [R, N, K, 3] float32, changes of the coefficients of spherical harmonics, K = 1 or 4
    series: np.ndarray  # [F, R] complex128, one row for each frequency of the motion

    def coefficients(self, gains: np.ndarray) -> np.ndarray:
        """[R] float32: c_r for gains [F] complex, which may hold a magnification."""
        return np.asarray((np.asarray(gains) @ self.series).real, np.float32)

    def selected(self, keep: np.ndarray) -> Light:
        """The modes `keep` [F] bool alone."""
        return replace(self, series=self.series[keep])

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Two [F] bool: whether the real part of mode k, its imaginary part, changes any colour."""
        return self.series.real.any(axis=1), self.series.imag.any(axis=1)

    def fits(self, n_frequencies: int, sh: tuple[int, ...]) -> bool:
        """Whether it goes with a motion of so many frequencies and Gaussians of spherical harmonics [N, K', 3]."""
        if self.shapes.ndim != 4 or self.series.shape != (n_frequencies, len(self.shapes)):
            return False
        if self.shapes.dtype != np.float32 or self.series.dtype != np.complex128:
            return False
        _, n, count, channels = self.shapes.shape
        return (n, channels) == (sh[0], 3) and count in (1, 4) and count <= sh[1]
