"""A tone in a given band of a record of any length: nothing is detected, and the ± is as wide as the record is short.

    y(t)  =  constant  +  drift(t)  +  Re[m exp(i 2π f t)]  +  noise

The drift is a Gaussian process of flat spectrum from 0 Hz to the band's lower end, as strong as all of the record: in
one period, a drift as large as the motion may look like it. f is anywhere in the band alike. For each f the phasor m is
that of generalised least squares; the answer is the mean over f, each by its evidence, and the deviations contain both
the error of m at f and its change with f (Rasmussen & Williams 2006, sections 2.7 and 5.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tg4mm.core.errors import Tg4mmError

FEWEST = 6  # samples
_TRIED = 8  # frequencies tried per 1 / duration, and in the band at least
_MOST = 2000  # samples at once: of more, neighbours are averaged
_ZOOMS, _NEGLIGIBLE = 4, 1e-4
_ROUNDING = 1e-9  # of the record's mean square: less noise cannot be distinguished from rounding


@dataclass(frozen=True)
class BandLine:
    """Re[phasor exp(i 2π f t)] of D components, t on the record's clock."""

    band: tuple[float, float]  # Hz
    hz: float
    hz_deviation: float
    phasor: np.ndarray  # [D] complex, units of the values
    amplitude_deviation: np.ndarray  # [D] standard deviation of the amplitudes
    periods: float  # of `hz` in the record


def tone_in(
    values: np.ndarray, times_s: np.ndarray, band: Sequence[float], noise: np.ndarray | float = 0.0
) -> BandLine:
    """Return the tone of values [T] or [T, D] at times [T] in seconds; band (low, high) in Hz.

    noise: standard deviation of each component's samples that is known from elsewhere; what lies above the band counts
    where it is larger. Raises Tg4mmError for fewer than 6 samples, and a band above half the rate.
    """
    t, y = np.asarray(times_s, np.float64), np.asarray(values, np.float64).reshape(len(times_s), -1)
    low, high = float(band[0]), float(band[1])
    if len(t) < FEWEST:
        raise Tg4mmError(f"{len(t)} samples are too few for an estimate at {low:g} to {high:g} Hz")
    known = np.broadcast_to(np.asarray(noise, np.float64), y.shape[1:])
    t, y, known = _averaged(t, y, known, high)
    duration = float(np.ptp(t)) * len(t) / (len(t) - 1)
    grid = np.linspace(low, high, max(int(_TRIED * (high - low) * duration), _TRIED) + 1)
    grid = grid[grid > 0]
    middle = float(t.mean())
    for _ in range(_ZOOMS):  # to where the evidence is, which may be narrower than a step
        means, variances, weights = _answers(grid, t - middle, y, low, known, high)
        likely = np.flatnonzero(weights > _NEGLIGIBLE)
        ends = grid[max(likely[0] - 1, 0)], grid[min(likely[-1] + 1, len(grid) - 1)]
        if ends == (grid[0], grid[-1]):
            break
        grid = np.linspace(*ends, len(grid))
    means, variances, weights = _answers(grid, t - middle, y, low, known, high)
    hz = float(weights @ grid)
    spread = float(np.sqrt(weights @ (grid - hz) ** 2))
    phasor = weights @ means
    total = weights @ (variances + np.abs(means - phasor) ** 2)
    turn = np.exp(-2j * np.pi * hz * middle)
    return BandLine((low, high), hz, spread, phasor * turn, np.sqrt(total), hz * duration)


def _answers(
    grid: np.ndarray, t: np.ndarray, y: np.ndarray, low: float, known: np.ndarray, high: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for frequencies [M] phasors [M, D] at t = 0, variances [M, D] of their parts, and weights [M] of sum 1."""
    each = [_at_each(grid, t, component, low, known[d], high) for d, component in enumerate(y.T)]
    means, variances, evidence = (np.stack(part, 1) for part in zip(*each, strict=True))
    total = evidence.sum(1)
    weights = np.exp(total - total.max())
    return means, variances, weights / weights.sum()


def _averaged(
    t: np.ndarray, y: np.ndarray, known: np.ndarray, high: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means of neighbours, where the record is long and the band allows it."""
    rate = (len(t) - 1) / float(np.ptp(t))
    if high >= rate / 2:
        raise Tg4mmError(f"{high:g} Hz is not below half the rate of {rate:.4g} Hz")
    block = min(-(-len(t) // _MOST), max(int(rate / (8 * high)), 1))
    if block < 2:
        return t[: 2 * _MOST], y[: 2 * _MOST], known
    n = len(t) // block * block
    return (
        t[:n].reshape(-1, block).mean(1),
        y[:n].reshape(-1, block, y.shape[1]).mean(1),
        known / np.sqrt(block),
    )


def _at_each(
    grid: np.ndarray, t: np.ndarray, y: np.ndarray, low: float, known: float, high: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return phasors [M], variances of their parts [M] and log evidence [M] of one component at frequencies [M]."""
    size = float(((y - y.mean()) ** 2).mean())
    if not size > 0:
        return np.zeros(len(grid), complex), np.full(len(grid), known**2), np.zeros(len(grid))
    level = max(known**2, _above(t, y, high), _ROUNDING * size)
    lags = t[:, None] - t
    factor = cho_factor(size * (low > 0) * np.sinc(2 * low * lags) + level * np.eye(len(t)))
    means, variances, evidence = [], [], []
    for f in grid:
        angles = 2 * np.pi * f * t
        design = np.stack([np.cos(angles), -np.sin(angles), np.ones_like(t)], 1)
        solved = cho_solve(factor, np.column_stack([design, y]))
        # parts of the phasor at most as large as the record: else poorly resolved frequencies would weigh as much
        information = design.T @ solved[:, :3] + np.diag([0.5 / size, 0.5 / size, 0.0])
        covariance = np.linalg.inv(information)
        right = design.T @ solved[:, 3]
        answer = covariance @ right
        means.append(complex(answer[0], answer[1]))
        variances.append(float((covariance[0, 0] + covariance[1, 1]) / 2))
        evidence.append(0.5 * float(right @ answer) + 0.5 * float(np.linalg.slogdet(covariance)[1]))
    return np.array(means), np.array(variances), np.array(evidence)


def _above(t: np.ndarray, y: np.ndarray, high: float) -> float:
    """Return the variance of the samples from motion above the band, as if it were white."""
    duration = float(np.ptp(t)) * len(t) / (len(t) - 1)
    slow = np.arange(int(high * duration) + 3) * np.pi * (t - t.min())[:, None] / float(np.ptp(t))
    columns = np.cos(slow)[:, : max(len(t) // 2, 1)]  # half periods: what goes on beyond the record's ends
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    return float((left**2).sum() / max(len(t) - columns.shape[1], 1))
