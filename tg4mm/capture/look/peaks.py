"""The strongest place and frequency of all pools: candidates for a line, each with the chance that noise makes it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from tg4mm.capture.look.pools import AggregationWindow
from tg4mm.capture.look.spectra import LOG2, spectrum, step

CHANCE = 0.01  # of one false line in a recording
LOWEST = 2.5  # periods in the record
_PEAK = 12.0  # statistic from which a point is looked at: one of 12,000 of noise is above
_BEAM = 6.0  # power over noise of a column that counts for a mode's shape: one of 400 of noise
_ENOUGH_SEEN = 0.2  # of the shape's weight that a picture must show
_PARTS = (4, 12)  # of the record: windows for what lives shortly
_FEWEST = 24  # pictures of a window
_SHORT_PEAK = 18.0
_WINDOW_FREEDOM = 50  # degrees of freedom of the floor in a window
_UNDERFLOW = 1e-250


@dataclass(frozen=True)
class PoolPeak:
    """A position in an aggregation window and a frequency there."""

    pool: int
    place: int
    hz: float
    statistic: float
    cut: float
    values: np.ndarray  # [M] complex amplitudes there
    window: float | None = None  # share of the record; None: all of it


@dataclass(frozen=True)
class PoolShape:
    """Columns of a pool and the weights that make one series of them."""

    columns: np.ndarray  # [m]
    weights: np.ndarray  # [m]
    seen_weights: np.ndarray  # [m]

    def series(self, residual: np.ndarray, seen: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return [F], and [F] bool: the pictures in which enough of the shape is seen."""
        total = residual[:, self.columns] @ self.weights
        if seen is None:
            return total, np.ones(len(total), bool)
        share = seen[:, self.columns] @ self.seen_weights / self.seen_weights.sum()
        enough = share > _ENOUGH_SEEN
        return np.where(enough, total / np.where(enough, share, 1), 0), enough


# (pool, first picture, one after the last): frequencies, power of the residual there, and its median
Spectra = dict[tuple[int, int, int], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class PeakSearch:
    """The pools of a recording and the frequencies at which lines are still sought."""

    pools: Sequence[AggregationWindow]
    times_s: np.ndarray  # [F]
    hz: np.ndarray  # [K]
    open: np.ndarray  # [K] bool
    tests: int  # places × frequencies of the whole record
    spectra: Spectra = field(default_factory=dict)  # of windows: kept by who changes the residuals

    def strongest(self) -> PoolPeak | None:
        """Return the most significant peak, if noise causes such a peak in at most one of a hundred recordings."""
        return self._of_record() or self._of_windows()

    def _of_record(self) -> PoolPeak | None:
        best: tuple[float, int, int, int, float] | None = None
        for j, pool in enumerate(self.pools):
            statistics = pool.statistics()
            statistics[~self.open] = 0
            rows, places = np.nonzero(statistics > _PEAK)
            if not len(rows):
                continue
            values = statistics[rows, places]
            chance = stats.f.sf(values / 2, 4, pool.freedom[rows])
            rank = np.where(chance < _UNDERFLOW, -values, chance)
            k = int(np.argmin(rank))
            if best is None or rank[k] < best[0]:
                best = (float(rank[k]), j, int(rows[k]), int(places[k]), float(values[k]))
        if best is None or best[0] > CHANCE / self.tests:
            return None
        _, j, row, place, value = best
        pool = self.pools[j]
        cut = 2 * float(stats.f.isf(CHANCE / self.tests, 4, pool.freedom[row]))
        return PoolPeak(j, place, float(self.hz[row]), value, cut, pool.amplitudes[row])

    def _of_windows(self) -> PoolPeak | None:
        """Return the most significant peak in windows of T/4 and T/12, for short vibrations."""
        frames, tests = len(self.times_s), self.tests
        best: tuple[float, PoolPeak] | None = None
        for length in (frames // part for part in _PARTS if frames // part >= _FEWEST):
            for first in range(0, frames - length + 1, length // 2):
                for j, pool in enumerate(self.pools):
                    n, found = self._in_window(j, pool, slice(first, first + length))
                    tests += n
                    if found is not None and (best is None or found[0] < best[0]):
                        best = found
        if best is None or best[0] > CHANCE / tests:
            return None
        return best[1]

    def _in_window(
        self, j: int, pool: AggregationWindow, rows: slice
    ) -> tuple[int, tuple[float, PoolPeak] | None]:
        """The number of tests, and the least chance with its peak."""
        times = self.times_s[rows]
        n, share = len(times), len(times) / len(self.times_s)
        key = (j, rows.start, rows.stop)
        if key not in self.spectra:
            hz, amplitudes = spectrum(pool.residual[rows], times)
            power = np.abs(amplitudes) ** 2 * share
            self.spectra[key] = hz, power, np.median(power[2:], 0) / LOG2
        hz, power, typical = self.spectra[key]
        at = np.minimum(np.round(hz / self.hz[1]).astype(int), len(self.hz) - 1)
        span = n * step(self.times_s)
        usable = self.open[at] & (hz >= LOWEST / span) & (hz <= 0.5 / step(self.times_s) - 0.5 / span)
        if not usable.any():
            return 0, None
        floor = np.maximum(pool.floor[at[usable]], typical)
        ratio = power[usable] / floor
        statistics = ratio.reshape(len(ratio), -1, 2).sum(2)
        r, places = np.nonzero(statistics > _SHORT_PEAK)
        if not len(r):
            return statistics.size, None
        values = statistics[r, places]
        chance = stats.f.sf(values / 2, 4, pool.freedom[at[usable]][r])
        k = int(np.argmin(chance))
        row = int(np.flatnonzero(usable)[r[k]])
        cut = 2 * float(stats.f.isf(CHANCE / self.tests, 4, _WINDOW_FREEDOM))
        amplitudes = spectrum(pool.residual[rows], times)[1][row] * share**0.5
        peak = PoolPeak(j, int(places[k]), float(hz[row]), float(values[k]), cut, amplitudes, share)
        return statistics.size, (float(chance[k]), peak)


def shape_of(peak: PoolPeak, floor: np.ndarray) -> PoolShape:
    """The mode's shape where the peak stands out, in one phase; weights are matched to it and to the noise."""
    above = np.abs(peak.values) ** 2 > _BEAM * floor
    above[[2 * peak.place, 2 * peak.place + 1]] = True
    columns = np.flatnonzero(above)
    values, noise = peak.values[columns], floor[columns]
    phase = 0.5 * np.angle((values**2 / noise).sum())
    weights = np.real(values * np.exp(-1j * phase)) / noise
    weights = weights / (weights**2 * noise).sum()
    return PoolShape(columns, weights, weights**2 * noise)


def beam_floor(pool: AggregationWindow, shape: PoolShape, row: int) -> float:
    """Return the noise power of the shape's series at a frequency: its median with the common shape."""
    power = np.abs(pool.amplitudes[:, shape.columns] @ shape.weights) ** 2
    return float(np.median(power[4:]) / LOG2 * np.median(pool.floor[row] / np.median(pool.floor, 0)))
