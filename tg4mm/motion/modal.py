"""Modal motion: per Gaussian one complex displacement and rotation per frequency (design §4.3 and §5.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ModalMotion:
    """x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)], g_k = 1 for f_k inside the band, else 0."""

    freqs_hz: np.ndarray  # [K] float64
    displacement: np.ndarray  # [K, N, 3] complex64, scene units
    rotation: np.ndarray  # [K, N, 3] complex64, rotation vectors in radians, world axes
    fps: float
    n_timesteps: int
