"""What of each mode is known: which modes hold nothing but noise, and the standard deviation of the others.

A fit gives a phasor for every bin of the record's Fourier transform, and most of them hold nothing. The run keeps them
all, since together they are the motion at every timestep and their median tells a peak from noise (`limits.py`); what
is handed on (a splat file, a band that is asked for) leaves the empty ones out.
"""

from __future__ import annotations

import numpy as np

from tg4mm.motion.modes import ModalMotion

_STRAY = 99.0  # percentile: Gaussians that hardly any camera sees must not say how large the noise is
_ROUNDING = 1e-12  # of the motion's power: what float32 does not hold
_OF_MOTION = 1e-6  # of the motion's power, where the run does not say its noise


def worth_keeping(motion: ModalMotion, noise: np.ndarray | None) -> np.ndarray:
    """[K] bool: all but the weakest modes, as long as those are together (mean square) less than the noise.

    noise [N]: standard deviation of each Gaussian's displacement by noise, scene units; None: not known, then a
    millionth of the motion's power takes its place. 0 Hz is kept: it is where the motion's own zero lies.
    """
    power = (np.abs(motion.displacement) ** 2).sum(2).mean(1) / 2
    oscillates = np.asarray(motion.freqs_hz) > 0
    total = float(power[oscillates].sum())
    allowed = _OF_MOTION * total
    if noise is not None and len(noise):
        usual = np.minimum(noise, np.percentile(noise, _STRAY)).astype(np.float64)
        allowed = max(_ROUNDING * total, float((usual**2).mean()))
    weakest = np.flatnonzero(oscillates)[np.argsort(power[oscillates], kind="stable")]
    keep = np.full(len(power), True)
    keep[weakest[np.cumsum(power[weakest]) <= allowed]] = False
    return keep


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
