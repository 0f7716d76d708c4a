"""Whether a run knows how far off its motion is: what it says of its uncertainty beside its true error."""

from __future__ import annotations

import numpy as np

from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.displacement import mean_squares

_TIMES = 2.0  # of the standard deviation that is said: beyond it an error was not foreseen


def uncertainty_figures(
    estimated: ModalMotion, true: ModalMotion, weights: np.ndarray, said: np.ndarray
) -> dict[str, float]:
    """Figures of `said` [N], the standard deviation of each Gaussian's displacement (rms over time, scene units).

    `said`, `error`: rms over Gaussians, weighted by `weights` [N], scene units. `within_two`: the part of the weight
    whose true error, rms over time, is at most twice what is said. Raises ValueError where `said` is for another
    number of Gaussians.
    """
    if said.shape != weights.shape:
        raise ValueError(f"the uncertainty is of {len(said)} Gaussians, the weights of {len(weights)}")
    error2, said2 = mean_squares(estimated, true)[0], said.astype(np.float64) ** 2
    total = weights.sum()
    return {
        "said": float(np.sqrt((said2 * weights).sum() / total)),
        "error": float(np.sqrt((error2 * weights).sum() / total)),
        "within_two": float(weights[error2 <= _TIMES**2 * said2].sum() / total),
    }
