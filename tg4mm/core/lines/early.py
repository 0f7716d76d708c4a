"""Test whether a ring-down is one exponential: a decay that differs in its first time constant widens the decay's ±.

Video compression attenuates small motion, so the end of a ring-down looks weaker than it is, and the damping of real
objects depends on amplitude. Neither is noise, so the deviation of a least-squares fit does not include it.
"""

import numpy as np
from scipy.optimize import minimize_scalar

from tg4mm.core.lines.model import Shape

_CYCLES, _FEWEST = 2, 12  # of a time constant, at least; samples in it
_RANGE = 0.25, 4.0  # times the decay


def early_decay_variance(shape: Shape, t: np.ndarray, own: np.ndarray, variance: float) -> float:
    """Return the variance to add to `variance` of a decay per second: 0 where both parts agree or one is too short.

    own [T, D]: the line plus the residual of all lines.
    """
    if not shape.is_free or shape.decay <= 0:
        return 0.0
    begin, constant = float(t[shape.start]), 1 / shape.decay
    early = (t >= begin) & (t <= begin + constant)
    if t[-1] < begin + 2 * constant or constant * shape.hz < _CYCLES or early.sum() < _FEWEST:
        return 0.0
    since, y = t - begin, own[t >= begin]
    whole = since[t >= begin]
    part, y_part = since[early], own[early]

    def left(log: float) -> float:
        basis = np.linalg.qr(_columns(shape.hz, float(np.exp(log)), part))[0]
        return -float(((basis.T @ y_part) ** 2).sum())

    bounds = tuple(np.log(shape.decay * np.array(_RANGE)))
    found = float(np.exp(minimize_scalar(left, bounds=bounds, method="bounded").x))
    told = [_information(shape, part, whole, y), _information(shape, whole, whole, y)]
    if told[0] <= 0:
        return 0.0
    # of nested samples' estimates, the variance of their difference is that of their variances
    apart = variance * max(told[1] / told[0] - 1, 0.0)
    return max((found - shape.decay) ** 2 - apart, 0.0)


def _columns(hz: float, decay: float, since: np.ndarray) -> np.ndarray:
    turning = np.exp((2j * np.pi * hz - decay) * since)
    return np.stack([turning.real, -turning.imag], 1)


def _information(shape: Shape, since: np.ndarray, whole: np.ndarray, y: np.ndarray) -> float:
    """Return the information on the decay in samples at `since` of the line fitted to `y` at `whole`, noise units."""
    weights = np.linalg.lstsq(_columns(shape.hz, shape.decay, whole), y, rcond=None)[0]
    columns = _columns(shape.hz, shape.decay, since)
    basis = np.linalg.qr(columns)[0]
    slope = -since[:, None] * (columns @ weights)
    return float(((slope - basis @ (basis.T @ slope)) ** 2).sum())
