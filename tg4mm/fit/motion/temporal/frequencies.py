"""Which frequencies a scene vibrates at, from series of several clocks with times of their own (dropped frames, clips).

Least-squares spectra (Lomb 1976, Scargle 1982) of every region's shift, each in units of its own noise, are averaged
over regions and clocks. A peak that stands out of the other frequencies is a frequency; its sinusoids are fitted to all
series and taken out, and the next is looked for in the residual. All frequencies found are then refined together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from tg4mm.core.lines.model import log_floor
from tg4mm.fit.motion.spectrum import polynomials, residual, sinusoids

MOST = 6
_OVERSAMPLED = 6  # frequencies tried per 1 / duration
_CAP = 300.0  # of a series' power over its noise: a few that move much do not hide the rest
_STANDS_OUT = 5.0  # robust deviations of the noise's logarithm above it
LEAST = 1.3  # times the noise: weaker peaks are noise, however smooth its spectrum is
_LOUD = 10.0  # times the noise: such a peak has side lobes all over a short record, and is taken out to see the noise
_WEAK = 0.03  # of the strongest peak's power above the floor: weaker is taken for leakage
_THIRDS = 3
_STRONG = 64  # series of one clock with the most power: they decide where frequencies are refined to
_LEAST_CLOCKS = 3  # from which on they tell how much they differ
_APART = 1.5  # over the duration, Hz: nearer ones are one whose amplitude changes, as a camera moves around


@dataclass(frozen=True)
class Frequencies:
    """Frequencies by falling strength."""

    hz: np.ndarray  # [K]
    deviation_hz: np.ndarray  # [K] standard deviation by noise (Cramér-Rao)

    def selected(self, keep: np.ndarray) -> "Frequencies":
        """Some of the frequencies [K] bool."""
        return Frequencies(self.hz[keep], self.deviation_hz[keep])


@dataclass(frozen=True)
class _Record:
    """The series of one clock, without what is slower than the lowest frequency."""

    y: np.ndarray  # [F, S]
    times_s: np.ndarray  # [F]
    noise: np.ndarray  # [S] variance of each series' noise

    @staticmethod
    def of(y: np.ndarray, times_s: np.ndarray, lowest_hz: float, grid: np.ndarray) -> "_Record":
        """The noise by the median over frequencies (of an exponential distribution)."""
        y = residual(y, polynomials(times_s, max(int(2 * lowest_hz * np.ptp(times_s) / 2), 1)))
        return _Record(y, times_s, np.median(_power(y, times_s, grid), axis=0) / np.log(2))

    def without(self, hz: np.ndarray) -> np.ndarray:
        """[F, S]: the residual of sinusoids of these frequencies [K]."""
        return residual(self.y, sinusoids(self.times_s, hz).T) if len(hz) else self.y

    def strongest(self) -> "_Record":
        """The series with the most power, each over its own noise."""
        told = self.noise > 0
        y = self.y[:, told] / np.sqrt(self.noise[told])
        return replace(self, y=y[:, np.argsort((y**2).sum(0))[::-1][:_STRONG]])

    def without_third(self, k: int) -> "_Record":
        """All but the k-th third of the frames."""
        kept = np.delete(np.arange(len(self.y)), np.array_split(np.arange(len(self.y)), _THIRDS)[k])
        return replace(self, y=self.y[kept], times_s=self.times_s[kept])


def find_frequencies(
    series: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    lowest_hz: float,
    highest_hz: float,
    least: float = LEAST,
) -> Frequencies:
    """The frequencies in series [F_c, S_c] of each clock at times [F_c] in seconds, between two frequencies.

    A peak counts from `least` times the noise's power.
    """
    duration = max(float(np.ptp(t)) for t in times)
    grid = np.arange(lowest_hz, highest_hz, 1 / (_OVERSAMPLED * duration))
    records = [_Record.of(y, t, lowest_hz, grid) for y, t in zip(series, times, strict=True)]
    hz, strongest = np.zeros(0), 0.0
    spectrum = _spectrum(records, hz, grid)
    while len(hz) < MOST:
        allowed = (np.abs(grid[:, None] - hz) >= _APART / duration).all(1)
        if not allowed.any():
            break
        peak = int(np.where(allowed, spectrum, -1).argmax())
        more = _refined(records, np.append(hz, grid[peak]), 1 / duration)
        if more.min() < lowest_hz:  # the flank of something slower than these records resolve
            break
        after, others = _spectrum(records, more, grid), allowed
        if spectrum[peak] > _LOUD:
            others = allowed & (np.abs(grid - grid[peak]) > _APART / duration)
        if not others.any():
            break
        floor, spread = log_floor(after if spectrum[peak] > _LOUD else spectrum, grid, others)
        above = float(np.log(max(spectrum[peak], 1e-12)) - floor[peak])
        power = float(spectrum[peak] - np.exp(floor[peak]))
        strongest = max(strongest, power)
        if above < max(_STANDS_OUT * spread, np.log(least)) or power < _WEAK * strongest:
            break
        if len(more) > 1 and np.diff(np.sort(more)).min() < 0.5 * _APART / duration:
            break
        hz, spectrum = more, after
    return Frequencies(hz, np.hypot(_cramer_rao(records, hz), _scatter(records, hz, 1 / duration)))


def _power(y: np.ndarray, t: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """[M, S]: power of each series at each frequency; mean 1 for white noise of variance 1."""
    products = (sinusoids(t, grid) @ y).reshape(len(grid), 2, -1)
    return np.asarray((products**2).sum(1) / len(t))


def _spectrum(records: Sequence[_Record], hz: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """[M]: mean over all series of power over noise, 1 for noise alone; sinusoids of frequencies [K] taken out."""
    total, count = np.zeros(len(grid)), 0
    for r in records:
        told = r.noise > 0
        total += np.minimum(_power(r.without(hz)[:, told], r.times_s, grid) / r.noise[told], _CAP).sum(1)
        count += int(told.sum())
    return total / max(count, 1)


def _refined(records: Sequence[_Record], hz: np.ndarray, step: float) -> np.ndarray:
    """All frequencies moved to where the residual is least, by at most `step`."""
    strongest = [r.strongest() for r in records]
    scale = np.sqrt(sum(float((r.y**2).sum()) for r in strongest)) or 1.0

    def misfit(f: np.ndarray) -> np.ndarray:
        return np.concatenate([r.without(f).ravel() for r in strongest]) / scale

    ends = hz - step, hz + step
    return np.asarray(least_squares(misfit, hz, bounds=ends, xtol=1e-9, ftol=1e-10, max_nfev=30).x)


def _scatter(records: Sequence[_Record], hz: np.ndarray, step: float) -> np.ndarray:
    """[K]: standard error of the frequencies, from how they differ between clocks and between thirds of the record.

    The larger of the two. What all clips have alike (a codec that follows the motion late after a clip's first picture,
    a vibration that changes) shows in thirds of the record alone.
    """
    if not len(hz):
        return np.zeros(0)

    def deviation(groups: Sequence[Sequence[_Record]]) -> np.ndarray:
        each = [_refined(own, hz, step / 2) for own in groups]
        return np.asarray(np.std(np.array(each), axis=0, ddof=1) / np.sqrt(len(groups)))

    thirds = [[r.without_third(k) for r in records] for k in range(_THIRDS)]
    within = np.asarray((_THIRDS - 1) * deviation(thirds))  # the jackknife's
    if len(records) < _LEAST_CLOCKS:
        return within
    return np.maximum(within, deviation([[r] for r in records]))


def _cramer_rao(records: Sequence[_Record], hz: np.ndarray) -> np.ndarray:
    """Bound of each frequency's deviation: σ_f² = 3 / (π² D² Σ SNR), D the duration, Σ over series of a² F / 2σ²."""
    out = []
    for f in hz:
        information = 0.0
        for r in records:
            told = r.noise > 0
            x = sinusoids(r.times_s, np.array([f])).T
            amplitude2 = (np.linalg.lstsq(x, r.y[:, told], rcond=None)[0] ** 2).sum(0)
            snr = len(x) * amplitude2 / (2 * r.noise[told])
            information += float(np.maximum(snr - 1, 0).sum()) * float(np.ptp(r.times_s)) ** 2
        out.append(np.sqrt(3 / (np.pi**2 * max(information, 1e-12))))
    return np.array(out)
