"""Modal motion: one complex displacement and rotation (phasor) per Gaussian and frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tg4mm.motion.appearance_modes import AppearanceModes


@dataclass(frozen=True)
class ModalMotion:
    """x(t, α) = x + Σ_k (1 + α·g_k) Re[m_k exp(i 2π f_k t / fps)], g_k = 1 for f_k inside the band, else 0.

    `appearance`, if any, changes the Gaussians' colours by the same modes, with the same gains g_k.

    A motion that is not a sum of sinusoids (ring-down, drift) has its own `gains` in place of the exponentials. Modes
    that are not `magnified` have g_k = 0 in any band.
    """

    freqs_hz: np.ndarray  # [K] float64
    displacement: np.ndarray  # [K, N, 3] complex64, scene units
    rotation: np.ndarray  # [K, N, 3] complex64, rotation vectors in radians, world axes
    fps: float  # Hz
    n_timesteps: int  # T
    gains: np.ndarray | None = None  # [K, T] complex128; None: the exponentials
    magnified: np.ndarray | None = None  # [K] bool; None: all above 0 Hz
    appearance: AppearanceModes | None = None  # changes of colour; None: there are none

    def gains_at(self, t: float) -> np.ndarray:
        """[K] complex128: exp(i 2π f_k t / fps), or the motion's own gains.

        Those are defined at whole timesteps: raises ValueError for any other t.
        """
        if self.gains is None:
            return np.asarray(np.exp(2j * np.pi * np.asarray(self.freqs_hz) * t / self.fps))
        if t != int(t) or not 0 <= t < self.gains.shape[1]:
            raise ValueError(f"timestep {t:g}: this motion is known at 0 … {self.gains.shape[1] - 1}")
        return np.asarray(self.gains[:, int(t)])

    def is_magnified(self) -> np.ndarray:
        """[K] bool. By default all but 0 Hz, the offset from the rest pose to the motion's own zero."""
        return self.freqs_hz > 0 if self.magnified is None else self.magnified

    def selected(self, keep: np.ndarray) -> ModalMotion:
        """Only the modes `keep` [K] bool."""
        return replace(
            self,
            freqs_hz=self.freqs_hz[keep],
            displacement=self.displacement[keep],
            rotation=self.rotation[keep],
            gains=None if self.gains is None else self.gains[keep],
            magnified=None if self.magnified is None else self.magnified[keep],
            appearance=None if self.appearance is None else self.appearance.selected(keep),
        )
