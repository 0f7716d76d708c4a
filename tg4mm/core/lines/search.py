"""Where the next line may be: matched filters of every frequency, decay and beginning, over the noise's level.

A filter's statistic Σ_d |Σ_t r_d e exp(−iωt)|² / (S_d Σ_t e²) is of exponentially distributed parts, one for each
component, where there is noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.core.lines.model import Shape

_OVERSAMPLED = 4  # frequencies to each 1 / duration
_DECAYS = 0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0  # e-foldings over the record
_GROWTHS = -1.5, -4.0
_BLOCKS = 32  # beginnings that are tried
_LEAST_SAMPLES, _LEAST_PERIODS = 8.0, 2.0  # of a filter's energy
_NEAR = (
    4.0  # over the duration, Hz: sidebands so near to a line are of its own changes if both sides have them
)


@dataclass(frozen=True)
class Candidate:
    """A shape and its statistic."""

    shape: Shape
    statistic: float


def candidates(
    residual: np.ndarray, t: np.ndarray, levels: np.ndarray, lines: Sequence[Shape], ends: tuple[float, float]
) -> list[Candidate]:
    """The best steady, the best decaying or growing, and the best one that begins in the record, of residual [T, D].

    levels [F, D] at the bins of the record. A frequency that is nearer than half of 1 / duration to one of the lines,
    or within its width, is none.
    """
    duration = float(np.ptp(t)) + float(np.median(np.diff(t)))
    grid = np.arange(ends[0], ends[1], 1 / (_OVERSAMPLED * duration))
    for s in lines:
        grid = grid[np.abs(grid - s.hz) >= max(0.5 / duration, abs(s.decay) / np.pi)]
    if not len(grid):
        return []
    level = np.stack([np.interp(grid * duration, np.arange(1, len(levels) + 1), own) for own in levels.T], 1)
    turned = np.exp(-2j * np.pi * grid[:, None] * (t - t[0]))
    whole = np.abs(turned @ residual) ** 2 / len(t)
    level = np.maximum(level, _mirrored(grid, whole, lines, duration))
    waves = [_all_along(turned, residual, t, level, grid, [0.0])]
    waves.append(_all_along(turned, residual, t, level, grid, [*_DECAYS[1:], *_GROWTHS]))
    waves.append(_beginning(turned, residual, t, level, grid))
    return [w for w in waves if w is not None]


def _mirrored(grid: np.ndarray, power: np.ndarray, lines: Sequence[Shape], duration: float) -> np.ndarray:
    """[F, D] the power on the other side of a near line: where both sides have it, its strength changes."""
    out = np.zeros_like(power)
    for s in lines:
        near = np.abs(grid - s.hz) < _NEAR / duration
        for shift in np.array([-0.5, 0.0, 0.5]) / duration:
            other = 2 * s.hz - grid[near] + shift
            out[near] = np.maximum(
                out[near], np.stack([np.interp(other, grid, p, left=0, right=0) for p in power.T], 1)
            )
    return out


def _all_along(
    turned: np.ndarray,
    residual: np.ndarray,
    t: np.ndarray,
    level: np.ndarray,
    grid: np.ndarray,
    rates: Sequence[float],
) -> Candidate | None:
    """Over the whole record. rates: e-foldings over it."""
    span, best = float(np.ptp(t)), None
    for rate in rates:
        shape = Shape(0.0, rate / span)
        e = shape.envelope(t)
        energy = float((e**2).sum())
        power = np.abs(turned @ (residual * e[:, None])) ** 2
        statistic = (power / (level * energy)).sum(1)
        statistic[~_is_long(energy, t, grid)] = 0
        at = int(statistic.argmax())
        if best is None or statistic[at] > best.statistic:
            best = Candidate(Shape(float(grid[at]), rate / span), float(statistic[at]))
    return best


def _beginning(
    turned: np.ndarray, residual: np.ndarray, t: np.ndarray, level: np.ndarray, grid: np.ndarray
) -> Candidate | None:
    """What begins at the first sample of a block and decays, or lasts."""
    span, best = float(np.ptp(t)), None
    edges = np.unique(np.linspace(0, len(t), _BLOCKS + 1).astype(int))
    sums = np.zeros((len(_DECAYS), *level.shape), complex)
    energies = np.zeros(len(_DECAYS))
    rates = np.array(_DECAYS) / span
    for first, last in zip(edges[-2:0:-1], edges[:1:-1], strict=True):
        own = slice(first, last)
        e = np.exp(-rates[:, None] * (t[own] - t[first]))
        carried = np.exp(-rates * (t[last] - t[first])) if last < len(t) else np.zeros(len(rates))
        weighted = (residual[own][:, None] * e.T[..., None]).reshape(last - first, -1)
        fresh = (turned[:, own] @ weighted).reshape(len(grid), len(rates), -1).transpose(1, 0, 2)
        sums = fresh + carried[:, None, None] * sums
        energies = (e**2).sum(1) + carried**2 * energies
        for k, energy in enumerate(energies):
            statistic = (np.abs(sums[k]) ** 2 / (level * energy)).sum(1)
            statistic[~_is_long(energy, t, grid)] = 0
            at = int(statistic.argmax())
            if best is None or statistic[at] > best.statistic:
                best = Candidate(Shape(float(grid[at]), float(rates[k]), int(first)), float(statistic[at]))
    return best


def _is_long(energy: float, t: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """[F] whether an envelope of so many samples' energy holds enough of each frequency."""
    step = float(np.median(np.diff(t)))
    return np.asarray((energy >= _LEAST_SAMPLES) & (energy * step * grid >= _LEAST_PERIODS / 2))
