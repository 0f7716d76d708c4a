"""How sure the amplitude of each mode is at each Gaussian."""

from __future__ import annotations

import numpy as np

from tg4mm.fit.motion.modes import ModalMotion


def mode_deviations(motion: ModalMotion, deviation: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """[K, N] float32 scene units: standard deviation of each mode's amplitude at each Gaussian.

    deviation, noise [N]: of the displacement, rms over time, root of the sum over x, y, z, in all and by noise alone
    (RUN/uncertainty.safetensors). How an error spreads over frequencies is not known. Noise is taken to lie at this one
    as a whole, which is the most it can be; errors of the model, which grow with the motion, by the mode's share of the
    motion's power. A sinusoid's amplitude is √2 times its rms.
    """
    power = (np.abs(motion.displacement) ** 2).sum(2).mean(1).astype(np.float64)
    total = float(power[np.asarray(motion.freqs_hz) > 0].sum())
    share = np.clip(power / total, 0, 1) if total > 0 else np.zeros_like(power)
    by_noise = np.asarray(noise, np.float64) ** 2
    by_model = np.maximum(np.asarray(deviation, np.float64) ** 2 - by_noise, 0)
    return np.sqrt(2 * (by_noise + share[:, None] * by_model)).astype(np.float32)
