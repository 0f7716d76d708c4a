"""The baseline of cells' misfits in a picture, and the cells that stand out."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tg4mm.capture.tracking.template import Grid

QUANTISED = 1 / 12  # grey levels² of noise that whole numbers have at least
LEAST_INFORMATION = 0.25  # px⁻²: a cell worse than 2 px a picture is not informative
OTHER = 0.5  # of the change beyond noise that a shift leaves: edges of what vibrates .1 to .5, wheels, leaves .6 to 1
BLOCK = np.ones((3, 3))
_CORE, _CORE_SPREADS = (
    2.5,
    6,
)  # times the baseline misfit, and deviations of the cells' scatter: what stands out


@dataclass(frozen=True)
class BaselineMisfit:
    """Cells' typical misfits beside the baseline."""

    typical: np.ndarray  # [C] grey levels²
    compared: np.ndarray  # [C] bool: cells that define the baseline
    level: float  # grey levels²
    spread: float  # of the logarithm
    noise: float  # grey levels²: the same of what moves, which a codec cannot take from the picture before

    @property
    def excess(self) -> np.ndarray:
        """Return [C]: logarithm of the typical misfit over the baseline one."""
        return np.asarray(np.log(self.typical / self.level))

    def stand_out(self) -> np.ndarray:
        """Return [C] bool: misfits that are far from baseline."""
        return np.asarray(self.excess > max(np.log(_CORE), _CORE_SPREADS * self.spread))


def baseline_of(
    misfit: np.ndarray, covariance: np.ndarray, grid: Grid, alone: np.ndarray | None = None
) -> BaselineMisfit:
    """Return the baseline misfit from misfits [F, C] and the covariances [C, 2, 2] of shifts for a misfit of 1.

    alone [F] bool: key frames. They contain noise and the quantiser's error; other frames only where something moves,
    since parts at rest are copied from the frame before.
    """
    typical = np.maximum(np.median(misfit, 0), QUANTISED)
    compared = _compared(typical, covariance, grid)
    level = float(np.median(typical[compared]))
    spread = 1.4826 * float(np.median(np.abs(np.log(typical[compared] / level))))
    noise = float(np.median(misfit[alone][:, compared])) if alone is not None and alone.any() else level
    return BaselineMisfit(typical, compared, level, spread, max(level, noise))


def _compared(typical: np.ndarray, covariance: np.ndarray, grid: Grid) -> np.ndarray:
    """Return cells [C] bool whose typical misfits [C] define the baseline: all, or the textured if most are plain.

    Most cells of a picture with an overexposed or rendered background have no noise but rounding, unlike the others.
    """
    if np.median(typical) > QUANTISED:
        return np.ones(len(typical), bool)
    noisy = typical > QUANTISED
    # A plain cell beside one with noise has some of its slopes.
    beside = ndimage.binary_dilation(grid.picture(noisy), BLOCK).ravel() & ~noisy
    informative = QUANTISED * np.einsum("cii->ci", covariance).min(1) < 1 / LEAST_INFORMATION
    compared = informative & ~beside
    return compared if compared.any() else np.ones(len(typical), bool)
