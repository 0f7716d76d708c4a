"""How bright a frame is: automatic exposure and white balance that wander, and light that flickers.

A gain multiplies linear light before the sensor sees it. It is never above 1, so that nothing clips that would not
clip without it.
"""

from __future__ import annotations

import numpy as np

_TONES = 3
_SLOWEST, _FASTEST = 0.3, 1.5  # cycles over the record
_LIMIT_HZ = 1.0  # a camera's own control is no faster


def drift_gains(percent: float, n_timesteps: int, fps: float, rng: np.random.Generator) -> np.ndarray:
    """Gains [T, 3] of red, green and blue: exposure by `percent` peak to peak, red and blue by a third more each."""
    exposure, red, blue = (slow_curve(n_timesteps, fps, rng) for _ in range(3))
    gains = np.repeat(1.0 - 0.01 * percent * exposure[:, None], 3, axis=1)
    gains[:, 0] *= 1.0 - 0.01 / 3 * percent * red
    gains[:, 2] *= 1.0 - 0.01 / 3 * percent * blue
    return gains


def slow_curve(n_timesteps: int, fps: float, rng: np.random.Generator) -> np.ndarray:
    """[T] from 0 to 1, both reached: a few cycles over the record at most, and none faster than 1 Hz."""
    seconds = n_timesteps / fps
    cycles = np.minimum(rng.uniform(_SLOWEST, _FASTEST, _TONES), _LIMIT_HZ * seconds)
    phases, sizes = rng.uniform(0.0, 2 * np.pi, _TONES), rng.uniform(0.5, 1.0, _TONES)
    turns = 2 * np.pi * np.outer(np.arange(n_timesteps) / n_timesteps, cycles)
    curve = np.sin(turns + phases) @ sizes
    return np.asarray((curve - curve.min()) / np.ptp(curve))


def flicker_gains(percent: float, hz: float, times_s: np.ndarray, phase: float) -> np.ndarray:
    """Gains [T] of light that flickers by `percent` peak to peak, at times on the scene's clock.

    The shutter is short and global: no bands run over the picture.
    """
    turns = (hz * np.asarray(times_s, np.float64)) % 1.0
    return 1.0 - 0.005 * percent * (1.0 - np.cos(2 * np.pi * turns + phase))
