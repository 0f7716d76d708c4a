"""How a mode goes in time: its complex gain g(t).

The convention, here and nowhere else. A mode of shape s (complex displacement field, scaled to its amplitude)
and phase φ moves the rest point x by

    Re[ −i · e^{iφ} · s(x) · g(t) ]      t in timesteps, timestep 0 is the reference frame

with g(t) = exp(i 2π f t/fps) · exp(−(t/fps)/decay) for a vibration: at phase 0 a real shape goes as s · sin(2π f
t/fps), at rest at t = 0; and g(t) = i · t/fps for a drift, which goes as s · t/fps. The product −i · e^{iφ} · s is
the stored mode shape m, so that every displacement is Re Σ_k m_k g_k(t), and (1 + α) times mode k if it is magnified.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

SINE = -1j  # Re[−i s exp(iωt)] = s sin ωt


class TimeLaw(Protocol):
    """The gain over time of a mode."""

    @property
    def frequency_hz(self) -> float:
        """0 if it does not oscillate."""

    def gain(self, timesteps: np.ndarray, fps: float) -> np.ndarray:
        """g at the given timesteps [T], complex128 [T]."""


@dataclass(frozen=True)
class Vibration:
    """A sinusoid, ringing down by 1/e every `decay_s` seconds if that is given."""

    frequency_hz: float
    decay_s: float | None = None

    def gain(self, timesteps: np.ndarray, fps: float) -> np.ndarray:
        t = np.asarray(timesteps, np.float64)
        # Whole turns are taken off first, so that equal phases give equal numbers at any t.
        g = np.exp(2j * np.pi * ((self.frequency_hz * t / fps) % 1.0))
        return g if self.decay_s is None else g * np.exp(-t / (fps * self.decay_s))


@dataclass(frozen=True)
class Ramp:
    """A linear growth: the shape is the displacement after one second."""

    @property
    def frequency_hz(self) -> float:
        return 0.0

    def gain(self, timesteps: np.ndarray, fps: float) -> np.ndarray:
        return 1j * np.asarray(timesteps, np.float64) / fps
