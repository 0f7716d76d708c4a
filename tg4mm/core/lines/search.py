"""Where the next line may be: matched filters of every frequency, decay and beginning, over the noise's level.

A filter's statistic Σ_d |Σ_t r_d e exp(−iωt)|² / (S_d Σ_t e²) is of exponentially distributed parts, one for each
component, where there is noise alone. Of all that stand out the one with most power is taken: a strong line's leakage
stands out, too.
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
_LEAST_SAMPLES, _LEAST_PERIODS = 8.0, 1.0  # of a filter's energy
# over the duration, Hz: sidebands so near to a line are its own changes if both sides have them
_NEAR = 8.0


@dataclass(frozen=True)
class Candidate:
    """A shape and its statistic."""

    shape: Shape
    statistic: float
    power: float = 0.0

    def or_better(self, other: Candidate, least: float) -> Candidate:
        """The one with more power, if its statistic is at least `least`; else the one that stands out more."""
        if (self.statistic >= least) != (other.statistic >= least):
            return max(self, other, key=lambda c: c.statistic)
        key = "power" if self.statistic >= least else "statistic"
        return max(self, other, key=lambda c: float(getattr(c, key)))


def candidates(
    residual: np.ndarray,
    t: np.ndarray,
    levels: np.ndarray,
    lines: Sequence[Shape],
    ends: tuple[float, float],
    least: float,
) -> list[Candidate]:
    """The best steady, the best decaying or growing, and the best one that begins in the record, of residual [T, D].

    levels [F, D] at the bins of the record; least: statistic from which on power decides. A frequency that is nearer to
    one of the lines than half of 1 / duration, than 1 / (the filter's own duration), or than the line is wide, is none.
    """
    look = _Look.of(residual, t, levels, lines, ends, least)
    if not len(look.hz):
        return []
    return [look.all_along([0.0]), look.all_along([*_DECAYS[1:], *_GROWTHS]), look.beginning()]


@dataclass(frozen=True)
class _Look:
    """What all filters of one residual share."""

    residual: np.ndarray  # [T, D]
    t: np.ndarray
    step: float  # s
    hz: np.ndarray  # [F]
    turned: np.ndarray  # [F, T] exp(−iωt)
    level: np.ndarray  # [F, D]
    away: np.ndarray  # [F] Hz to the nearest line; −1 within the width of one
    beside: np.ndarray  # [M] near a line
    mirrored: np.ndarray  # [5, M] on its other side
    least: float

    @staticmethod
    def of(
        residual: np.ndarray,
        t: np.ndarray,
        levels: np.ndarray,
        lines: Sequence[Shape],
        ends: tuple[float, float],
        least: float,
    ) -> _Look:
        step = float(np.median(np.diff(t)))
        duration = float(np.ptp(t)) + step
        hz = np.arange(ends[0], ends[1], 1 / (_OVERSAMPLED * duration))
        bins = np.arange(1, len(levels) + 1)
        level = np.stack([np.interp(hz * duration, bins, own) for own in levels.T], 1)
        away, beside, mirrored = np.full(len(hz), np.inf), [np.zeros(0, int)], [np.zeros((5, 0), int)]
        for s in lines:
            off = np.abs(hz - s.hz)
            away = np.where(off < max(0.5 / duration, abs(s.decay) / np.pi), -1, np.minimum(away, off))
            near = np.flatnonzero(off < _NEAR / duration)
            other = np.rint((2 * s.hz - hz[near] - ends[0]) * _OVERSAMPLED * duration).astype(int)
            beside.append(near)
            mirrored.append(np.clip(other + np.arange(-2, 3)[:, None], 0, len(hz) - 1))
        turned = np.exp(-2j * np.pi * hz[:, None] * (t - t[0]))
        sides = np.concatenate(beside), np.concatenate(mirrored, 1)
        return _Look(residual, t, step, hz, turned, level, away, *sides, least)

    def all_along(self, rates: Sequence[float]) -> Candidate:
        """Over the whole record. rates: e-foldings over it."""
        span, best = float(np.ptp(self.t)), Candidate(Shape(0.0), 0.0)
        for rate in rates:
            shape = Shape(0.0, rate / span)
            e = shape.envelope(self.t)
            sums = self.turned @ (self.residual * e[:, None])
            best = best.or_better(self._highest(sums, float((e**2).sum()), shape), self.least)
        return best

    def beginning(self) -> Candidate:
        """What begins at the first sample of a block and decays, or lasts."""
        t, best = self.t, Candidate(Shape(0.0), 0.0)
        edges = np.unique(np.linspace(0, len(t), _BLOCKS + 1).astype(int))
        rates = np.array(_DECAYS) / float(np.ptp(t))
        sums = np.zeros((len(rates), *self.level.shape), complex)
        energies = np.zeros(len(rates))
        for first, last in zip(edges[-2:0:-1], edges[:1:-1], strict=True):
            own = slice(first, last)
            e = np.exp(-rates[:, None] * (t[own] - t[first]))
            carried = np.exp(-rates * (t[last] - t[first])) if last < len(t) else np.zeros(len(rates))
            weighted = (self.residual[own][:, None] * e.T[..., None]).reshape(last - first, -1)
            fresh = (self.turned[:, own] @ weighted).reshape(len(self.hz), len(rates), -1)
            sums = fresh.transpose(1, 0, 2) + carried[:, None, None] * sums
            energies = (e**2).sum(1) + carried**2 * energies
            for k, energy in enumerate(energies):
                shape = Shape(0.0, float(rates[k]), int(first))
                best = best.or_better(self._highest(sums[k], float(energy), shape), self.least)
        return best

    def _highest(self, sums: np.ndarray, energy: float, shape: Shape) -> Candidate:
        """Of one filter's sums [F, D]; the frequency is that of the power's own peak nearby."""
        power = np.abs(sums) ** 2 / energy
        level = self.level
        if len(self.beside):
            level = level.copy()
            level[self.beside] = np.maximum(level[self.beside], power[self.mirrored].max(0))
        lasts = energy * self.step
        allowed = (self.hz * lasts >= _LEAST_PERIODS) & (
            self.away > (0.5 if lasts > 0.5 * np.ptp(self.t) else 1) / lasts
        )
        if energy < _LEAST_SAMPLES or not allowed.any():
            return Candidate(shape, 0.0)
        statistic = np.where(allowed, (power / level).sum(1), 0.0)
        total = (power / self.level.mean(0)).sum(1)
        stands_out = statistic >= self.least
        at = int((np.where(stands_out, total, 0) if stands_out.any() else statistic).argmax())
        first = max(at - _OVERSAMPLED, 0)
        peak = first + int((power[first : at + _OVERSAMPLED + 1] / self.level[at]).sum(1).argmax())
        hz = float(self.hz[peak if allowed[peak] else at])
        return Candidate(Shape(hz, shape.decay, shape.start), float(statistic[at]), float(total[at]))
