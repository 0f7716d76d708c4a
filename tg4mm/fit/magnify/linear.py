"""Linear magnification: what a Gaussian does over time is filtered, and α times the band is added.

For embeddings (`paper`) it is the series of every channel since timestep 0; for modal motion the displacement and
rotation series, which gives a modal motion again.
"""

from dataclasses import replace

import numpy as np

from tg4mm.core.magnification import Magnification, apply_response
from tg4mm.core.phasors import series_modes
from tg4mm.fit.motion.animate import displacement_at, mode_gains, rotation_at
from tg4mm.fit.motion.modes import ModalMotion


def magnified_series(series: np.ndarray, response: np.ndarray) -> np.ndarray:
    """series [T, …] plus its change since timestep 0 filtered by `response` [T // 2 + 1] (Σ over bands α · filter)."""
    return series + apply_response(series - series[:1], response)


def magnified_motion(motion: ModalMotion, plan: Magnification) -> ModalMotion:
    """The motion with displacement, rotation and appearance of every Gaussian filtered over time and magnified.

    With ideal bands and modes on DFT bins this is multiplying the phasors, what `modal` does. Modes between the bins
    spread over them, and are magnified as far as they lie in the band.
    """
    steps = range(motion.n_timesteps)
    series = np.stack(
        [np.concatenate([displacement_at(motion, t), rotation_at(motion, t)], 1) for t in steps]
    )
    freqs, phasors = series_modes(series, motion.fps)
    factors = 1 + plan.response(freqs, motion.fps)
    phasors = phasors * factors.astype(np.complex64)[:, None, None]
    appearance = motion.appearance
    if appearance is not None:
        values = np.stack([appearance.coefficients(mode_gains(motion, t, 0.0)) for t in steps])
        series = series_modes(values, motion.fps)[1].astype(np.complex128)
        appearance = replace(appearance, series=series * factors[:, None])
    return replace(
        motion, freqs_hz=freqs, displacement=phasors[..., :3], rotation=phasors[..., 3:],
        gains=None, magnified=None, appearance=appearance,
    )  # fmt: skip
