"""Least squares by sinusoids: what the searches for frequencies share (`spectrum.py`, `temporal/frequencies.py`)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre
from scipy.optimize import least_squares


def sinusoids(times_s: np.ndarray, freqs_hz: np.ndarray) -> np.ndarray:
    """[2K, F]: cos 2πf_k t and −sin 2πf_k t in pairs: Re[m exp(i 2πf t)] = Re m · row 2k + Im m · row 2k + 1."""
    angles = 2 * np.pi * np.asarray(freqs_hz)[:, None] * times_s
    return np.stack([np.cos(angles), -np.sin(angles)], 1).reshape(-1, len(times_s))


def polynomials(times_s: np.ndarray, degree: int) -> np.ndarray:
    """[F, degree + 1]: Legendre polynomials over the record."""
    span = max(float(np.ptp(times_s)), 1e-12)
    return np.asarray(legendre.legvander(2 * (times_s - times_s.min()) / span - 1, degree))


def constant_and_trend(times_s: np.ndarray) -> np.ndarray:
    """[2, F]."""
    return np.stack([np.ones_like(times_s), times_s - times_s.mean()])


def residual(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Series y [F, S] less their least-squares fit by functions of time x [F, P]."""
    return np.asarray(y - x @ np.linalg.lstsq(x, y, rcond=None)[0])


def far_from(grid: np.ndarray, taken: np.ndarray, least: float) -> np.ndarray:
    """[M] bool: which frequencies of a grid are at least so far from all that are `taken` [K]."""
    return np.asarray((np.abs(grid[:, None] - taken) >= least).all(1))


def refined(
    misfit: Callable[[np.ndarray], np.ndarray], start: np.ndarray, step: float, **ends: float
) -> np.ndarray:
    """Frequencies moved by at most `step` to the least squares of `misfit` (variable projection).

    `ends`: tolerances, and the largest number of steps, as `scipy.optimize.least_squares` takes them.
    """
    return np.asarray(least_squares(misfit, start, bounds=(start - step, start + step), **ends).x)
