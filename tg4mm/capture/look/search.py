"""Search for lines, the strongest first: each is tested strictly and subtracted from every cell before the next search.

A false-discovery rate over points (Benjamini-Hochberg) would admit false lines beside a strong one with many
discoveries. So the strongest place and frequency is tested alone (Bonferroni over all places and frequencies), must
explain its neighbourhood in frequency, and must be visible beside its strongest cell.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from tg4mm.capture.look.baseline import QUANTISED
from tg4mm.capture.look.model import Smallest
from tg4mm.capture.look.order import positions_apart
from tg4mm.capture.look.peaks import (
    CHANCE,
    LOWEST,
    PeakSearch,
    PoolPeak,
    PoolShape,
    Spectra,
    beam_floor,
    shape_of,
)
from tg4mm.capture.look.pools import AggregationWindow, pools_of
from tg4mm.capture.look.scene import PATTERNS, CellScene
from tg4mm.capture.look.spectra import spectrum
from tg4mm.core.lines import Line as Vibration
from tg4mm.core.lines import alias, fit_line_near

MOST = 24  # lines
_WANDER_BINS = 6  # neighbourhood that a line must explain
_LEFT, _LEFT_SHARE = 2.5, 0.15  # what may stay there, times the noise or of half the statistic
_SUPPORT = 7.0  # statistic of the place without its strongest cell: one of 140 of noise is above
_TRIES = 2  # at one frequency
_CLEAR = 4.0  # times what noise exceeds: a place at a rim has little support, one beside it more
_UNRESOLVED = 0.5  # share of a line's columns that others must leave: that of half a bin between them
_FRAMES_A_COLUMN = 2  # frames for each coefficient of the lines, at least
_FEW_LINES = 8  # lines that the record must support, for every position to have an amplitude of its own
_IMAGE_SURE = 10.0  # times weaker than a line it may be an image of


@dataclass
class PoolLine:
    """A detected line, its mode's shape, and its part in every window."""

    vibration: Vibration
    statistic: float  # power over noise, summed over two axes: χ² / 2 of 4 degrees of freedom where all rests
    cut: float  # the statistic that noise alone exceeds once in a hundred recordings
    pool: int
    shape: PoolShape
    noise: float  # standard deviation of the shape's series
    taken: list[np.ndarray] = field(default_factory=list)  # of each pool [B, M]: coefficients of `columns`
    plain: list[np.ndarray] = field(default_factory=list)  # of each pool [2, M]: cosine and sine


class Search:
    """The lines of a scene, and its windows without them."""

    def __init__(self, scene: CellScene) -> None:
        self.scene, self.times = scene, scene.times_s
        self.pools = pools_of(scene)
        self.lines: list[PoolLine] = []
        self.hz = spectrum(self.times[:, None] * 0, self.times)[0]
        d, top = scene.duration, 0.5 / scene.dt
        self.allowed = (self.hz >= LOWEST / d) & (self.hz <= top - 0.5 / d)
        typical = np.median(scene.series.misfit, 0).reshape(scene.grid.rows, scene.grid.columns)
        self._repeated = (
            typical[tuple(self.pools[0].corner.T)] <= QUANTISED if self.pools else np.zeros(0, bool)
        )
        self._open = self.allowed.copy()
        self._apart = self._frames_apart()
        self._tries: dict[int, int] = {}
        self._spectra: Spectra = {}
        self.composite = np.mean(self.pools[0].statistics(), 1) / 2 if self.pools else np.ones(len(self.hz))
        if self.pools and self._open.any():
            self._find()
            self._again()
            self._make_plain()

    def _frames_apart(self) -> np.ndarray:
        """[n, F] bool: groups of frames with an amplitude of their own, as few as the record's length supports."""
        everywhere = np.ones((1, len(self.times)), bool)
        if not self.scene.treats_apart:
            return everywhere
        by_position = positions_apart(self.scene.series.kinds).T
        if _FRAMES_A_COLUMN * 2 * len(by_position) * _FEW_LINES <= len(self.times):
            return by_position
        return np.stack([~self.scene.between, self.scene.between])

    @property
    def _tests(self) -> int:
        return int(self.allowed.sum()) * sum(len(pool) for pool in self.pools)

    def bin_of(self, hz: float) -> int:
        return int(np.argmin(np.abs(self.hz - hz)))

    def smallest(self) -> tuple[Smallest, ...]:
        """Return the least amplitude of a steady line that passes the test, for each size of place."""
        out = []
        for pool in self.pools:
            cut = 2 * stats.f.isf(CHANCE / max(self._tests, 1), 4, pool.freedom[self.allowed])
            needed = np.sqrt(cut[:, None] * pool.sure_floor[self.allowed][:, ::2])
            if needed.size:
                of_place = np.median(needed, 0)
                across = pool.size * self.scene.grid.size
                out.append(Smallest(across, float(np.median(of_place)), float(np.percentile(of_place, 10))))
        return tuple(out)

    def columns(self, line: Vibration) -> np.ndarray:
        """[F, 2 n]: columns of a line; each of n positions in a row of B-frames has a separate amplitude."""
        plain = line.columns(self.times)
        return np.concatenate([plain * some[:, None] for some in self._apart], 1)

    def _find(self) -> None:
        room = len(self.times) // (_FRAMES_A_COLUMN * 2 * len(self._apart))
        for _ in range(MOST):
            if len(self.lines) >= max(room, 1):
                return
            peak = PeakSearch(
                self.pools, self.times, self.hz, self._open, self._tests, self._spectra
            ).strongest()
            if peak is None:
                return
            self._judge(peak)

    def _judge(self, peak: PoolPeak) -> None:
        """Accept the peak as a line; else raise the noise around it, or close its frequency."""
        pool, scene = self.pools[peak.pool], self.scene
        row = self.bin_of(peak.hz)
        shape = shape_of(peak, pool.sure_floor[row])
        series, seen = shape.series(pool.residual, pool.seen)
        width = scene.duration if peak.window is None else peak.window * scene.duration
        floor = beam_floor(pool, shape, row)
        noise = float(np.sqrt(len(self.times) / 4 * floor))
        vibration = fit_line_near(series[seen], self.times[seen], peak.hz, 1 / width, noise)
        wander = self._wander(series, seen, vibration) / floor
        statistic = peak.statistic
        if peak.window is not None or vibration.decay_per_s:
            statistic = max(statistic, _statistic(pool, peak.place, row, vibration, self.times))
        key = round(peak.hz * scene.duration)
        self._tries[key] = self._tries.get(key, 0) + 1
        taken = self._is_image(vibration.hz, statistic) or self._is_unresolved(vibration)
        if taken or self._tries[key] > _TRIES:
            self._open &= np.abs(self.hz - peak.hz) >= 0.75 / scene.duration
            return
        explains = wander <= max(_LEFT, _LEFT_SHARE * statistic / 2) and statistic >= peak.cut * wander
        support = self._support(peak, vibration, row)
        if not explains or self._is_near(vibration):
            self._raise(peak, vibration.hz, max(wander, 2.0))
            return
        if support < _least_support(peak):
            self._tries[key] -= int(statistic > _CLEAR * peak.cut)
            self._raise(peak, vibration.hz, max(wander, 2.0), statistic > _CLEAR * peak.cut)
            return
        self.lines.append(PoolLine(vibration, statistic, peak.cut, peak.pool, shape, noise))
        self._take_off()
        self._spectra.clear()
        for each in self.pools:
            each.update(self.times)
        half = max(1 / scene.duration, 2.5 * abs(vibration.decay_per_s) / (2 * np.pi))
        self._open &= np.abs(self.hz - vibration.hz) >= half

    def _wander(self, series: np.ndarray, seen: np.ndarray, vibration: Vibration) -> float:
        """Return the mean power of the residual around a line's frequency."""
        columns = self.columns(vibration)
        left = (series - columns @ np.linalg.lstsq(columns[seen], series[seen], rcond=None)[0]) * seen
        around = (np.abs(self.hz - vibration.hz) < _WANDER_BINS / self.scene.duration) & self.allowed
        power = np.abs(spectrum(left[:, None], self.times)[1][around, 0]) ** 2
        return float(power.mean() / seen.mean()) if len(power) else np.inf  # fitted outside what is searched

    def _is_image(self, hz: float, statistic: float) -> bool:
        """Return whether hz is an image of a much stronger line by the codec's pattern, j rate / n ± f, period n."""
        return any(
            line.statistic > _IMAGE_SURE * statistic
            and any(
                abs(image - hz) < 1 / self.scene.duration
                for image in images(line.vibration.hz, 1 / self.scene.dt, self.scene.patterns)
            )
            for line in self.lines
        )

    def _is_unresolved(self, vibration: Vibration) -> bool:
        """Return whether the columns of the lines before explain most of a line.

        It is then an image of one of them by the order of B-frames, or cannot be distinguished from one.
        """
        if not self.lines:
            return False
        taken = np.linalg.qr(np.concatenate([self.columns(line.vibration) for line in self.lines], 1))[0]
        own = vibration.columns(self.times)
        return float(np.sum((own - taken @ (taken.T @ own)) ** 2)) < _UNRESOLVED * float(np.sum(own**2))

    def _is_near(self, vibration: Vibration) -> bool:
        """Return whether a detected line is too near to be resolved."""
        resolution, rate = 1 / self.scene.duration, abs(vibration.decay_per_s)
        others = (line.vibration for line in self.lines)
        return any(
            abs(vibration.hz - o.hz) < max(resolution, (rate + abs(o.decay_per_s)) / np.pi) for o in others
        )

    def _raise(self, peak: PoolPeak, hz: float, factor: float, alone: bool = False) -> None:
        """Raise the noise floor by a factor around a frequency and place, or at the place alone."""
        around = np.flatnonzero((np.abs(self.hz - hz) < _WANDER_BINS / self.scene.duration) & self.allowed)
        here = self.pools[peak.pool]
        for pool in self.pools:
            reach = self.scene.grid.size * (1.5 + max(pool.size, here.size) / 2)
            far = np.linalg.norm(pool.centre - here.centre[peak.place], axis=1)
            near = (far == 0) & (pool is here) if alone else far < reach
            columns = np.flatnonzero(np.repeat(near, 2))
            pool.raised[np.ix_(around, columns)] *= factor
            pool.floor[np.ix_(around, columns)] *= factor

    def _support(self, peak: PoolPeak, vibration: Vibration, row: int) -> float:
        """Return the line's statistic in a place's cells without the strongest, or around a single cell.

        Cells that a codec repeats bit for bit do not count: it may have taken their motion with their noise.
        """
        cells, here = self.pools[0], self.pools[peak.pool]
        offset = cells.corner - here.corner[peak.place]
        if here.size > 1:
            places = np.flatnonzero(((offset >= 0) & (offset < here.size)).all(1))
        else:
            places = np.flatnonzero((np.abs(offset) < 2).all(1))
        places = places[~self._repeated[places]] if here.size > 1 else places
        if not len(places):
            return 0.0
        columns = np.stack([2 * places, 2 * places + 1], 1).ravel()
        basis = vibration.columns(self.times)
        fit = cells.in_picture(cells.fitted(basis, cells.residual[:, columns], columns), places)
        precision = 2 / (len(self.times) * cells.sure_floor[row, columns].reshape(-1, 2))
        axes = cells.axes[places]
        weights = np.einsum("cxa,ca,cya->cxy", axes, precision, axes)
        products = basis.T @ basis
        each = np.einsum("icx,cxy,jcy,ij->c", fit, weights, fit, products)
        kept = np.arange(len(places)) != np.argmax(each) if here.size > 1 else (offset[places] != 0).any(1)
        if not kept.any():
            return 0.0
        total = weights[kept].sum(0)
        common = np.linalg.solve(total, np.einsum("cxy,icy->xi", weights[kept], fit[:, kept])).T
        return float(np.einsum("ix,xy,jy,ij->", common, total, common, products))

    def _take_off(self, pools: Iterable[int] | None = None) -> None:
        """Subtract every line from some pools; None: from all."""
        parts = [self.columns(line.vibration) for line in self.lines]
        stops = np.cumsum([part.shape[1] for part in parts])[:-1]
        columns = np.concatenate(parts, 1)
        for line in self.lines:
            line.taken = line.taken or [np.zeros(0)] * len(self.pools)
        for k in range(len(self.pools)) if pools is None else pools:
            pool = self.pools[k]
            fit = pool.fitted(columns, pool.series)
            pool.residual = pool.series - columns @ fit
            if pool.seen is not None:
                pool.residual *= pool.seen
            for line, share in zip(self.lines, np.split(fit, stops), strict=True):
                line.taken[k] = share

    def _make_plain(self) -> None:
        """Fit every line's cosine and sine to all pictures, B-frames included."""
        for line in self.lines:
            columns, plain = self.columns(line.vibration), line.vibration.columns(self.times)
            line.plain = list(line.taken)
            if columns.shape[1] > 2:
                pairs = zip(self.pools, line.taken, strict=True)
                line.plain = [
                    pool.fitted(plain, pool.residual + columns @ coefficients) for pool, coefficients in pairs
                ]

    def _again(self) -> None:
        """Fit each line again with the others subtracted; twice, as they depend on each other."""
        if len(self.lines) < 2:
            return
        pools = {line.pool for line in self.lines}
        for line in [*self.lines, *self.lines]:
            series, seen = self.series_of(line)
            hz, width = line.vibration.hz, 1 / self.scene.duration
            line.vibration = fit_line_near(series[seen], self.times[seen], hz, width, line.noise)
            self._take_off(pools)
        self._take_off()

    def series_of(self, line: PoolLine) -> tuple[np.ndarray, np.ndarray]:
        """Return the series [F] of a line's shape without the other lines, and [F] bool: where enough of it is seen."""
        pool = self.pools[line.pool]
        fitted = self.columns(line.vibration) @ line.taken[line.pool]
        if pool.seen is not None:
            fitted = fitted * pool.seen
        return line.shape.series(pool.residual + fitted, pool.seen)


def _least_support(peak: PoolPeak) -> float:
    """Return the least support at one rate of false lines, for the whole record or for half-overlapping windows."""
    if peak.window is None:
        return _SUPPORT
    return float(stats.gamma.isf(stats.gamma.sf(_SUPPORT, 2) * peak.window / 2, 2))


def images(hz: float, rate: float, patterns: tuple[int, ...] = PATTERNS) -> list[float]:
    """Return the frequencies at which frames of periodic quality show a line at hz, for each period of `patterns`."""
    return [alias(j * rate / n + sign * hz, rate) for n in patterns for j in range(1, n) for sign in (1, -1)]


def _statistic(
    pool: AggregationWindow, place: int, row: int, vibration: Vibration, times_s: np.ndarray
) -> float:
    basis = vibration.columns(times_s)
    both = [2 * place, 2 * place + 1]
    explained = ((np.linalg.qr(basis)[0].T @ pool.residual[:, both]) ** 2).sum(0)
    return float((explained / (len(times_s) / 2 * pool.floor[row, both])).sum())
