"""One vibration in one series: steady, ringing down from the first picture on, or begun by a hit during the record."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from tg4mm.capture.look.spectra import explained, refined, tone

STEADY, RING, HIT = "steady", "decays", "begins"
_MOST_DAMPING = 0.12  # ratio; what decays faster has no frequency of its own to speak of
_DECAYS = (0.5, 1.5, 4.0, 10.0, 25.0, 60.0)  # over the record, where a search begins
_STARTS = 32  # of a hit
_SURE = 2.5  # deviations of the decay from none


@dataclass(frozen=True)
class Vibration:
    """hz and decay (1/s) with their standard deviations; start_s None: from the first picture on."""

    hz: float
    decay: float = 0.0
    start_s: float | None = None
    kind: str = STEADY
    hz_deviation: float = np.inf
    decay_deviation: float = 0.0

    def columns(self, times_s: np.ndarray) -> np.ndarray:
        """[F, 2]: cosine and sine, decaying since the start, nothing before it."""
        return _columns(times_s, self.hz, self.decay, times_s[0] if self.start_s is None else self.start_s)

    @property
    def damping(self) -> float:
        """Damping ratio."""
        return float(self.decay / np.hypot(2 * np.pi * self.hz, self.decay))

    @property
    def damping_deviation(self) -> float:
        """Of the damping ratio."""
        return float(self.decay_deviation / np.hypot(2 * np.pi * self.hz, self.decay))


def _columns(times_s: np.ndarray, hz: float, decay: float, start: float) -> np.ndarray:
    x = times_s - start
    envelope = np.where(x >= -1e-9, np.exp(-decay * np.clip(x, 0, None)), 0.0)
    return np.asarray(envelope[:, None] * tone(x, hz))


def fitted(
    series: np.ndarray,
    times_s: np.ndarray,
    hz: float,
    noise: float,
    width_hz: float | None = None,
    whole: np.ndarray | None = None,
) -> Vibration:
    """The vibration near hz in series [F] whose noise has variance `noise`: the simplest kind that BIC allows.

    width_hz: how far from hz it may lie, for what lives shorter than the record. whole [F] bool: pictures that keep
    small motion; the decay is of these alone where they can tell it, as what others lose would pass for damping.
    """
    duration = float(times_s[-1] - times_s[0])
    steady_hz = refined(series, times_s, hz) if width_hz is None else hz
    steady = explained(series, tone(times_s, steady_hz))
    search = _Search(series, times_s, width_hz or 1 / duration, steady_hz)
    best = Vibration(steady_hz)
    penalty = np.log(len(times_s)) * noise
    if duration * steady_hz > 2 and (ring := search.ring()) is not None:
        hit = search.hit()
        # A hit has one more parameter than a ring; its start is searched over the whole record, which BIC of a smooth
        # likelihood does not count.
        if hit is not None and hit[0] - ring[0] > 3 * penalty and hit[0] - steady > 4 * penalty:
            best = Vibration(hit[1][0], hit[1][1], hit[1][2], HIT)
        elif ring[0] - steady > penalty:
            best = Vibration(ring[1][0], ring[1][1], None, RING)
    every = _with_deviations(best, series, times_s, noise, None)
    if not best.decay:
        return every
    if every.decay < _SURE * every.decay_deviation:
        return _with_deviations(Vibration(steady_hz), series, times_s, noise, None)
    if whole is None:
        return every
    of_whole = _decay_of(best, series[whole], times_s[whole], times_s[0])
    of_whole = _with_deviations(of_whole, series, times_s, noise, whole)
    if of_whole.decay < _SURE * of_whole.decay_deviation:  # too few to tell how fast: all tell that it decays
        return replace(every, decay_deviation=max(every.decay_deviation, of_whole.decay_deviation))
    return of_whole


class _Search:
    """Grids, then the simplex method (Nelder and Mead 1965) from their best point."""

    def __init__(self, series: np.ndarray, times_s: np.ndarray, half_hz: float, hz: float) -> None:
        self.series, self.times, self.hz, self.half = series, times_s, hz, half_hz
        self.duration = float(times_s[-1] - times_s[0])
        rates = np.array(_DECAYS) / self.duration
        self.decays = [float(d) for d in rates if d < 2 * np.pi * hz * _MOST_DAMPING]

    def ring(self) -> tuple[float, np.ndarray] | None:
        """Energy explained, and (hz, decay)."""
        grid = [(self._energy((f, d)), (f, d)) for d in self.decays for f in self._frequencies(d)]
        if not grid:
            return None
        _, (f, d) = max(grid)
        return self._climbed((f, d), (0.2 / self.duration, 0.3 * d))

    def hit(self) -> tuple[float, np.ndarray] | None:
        """Energy explained, and (hz, decay, start)."""
        starts = self.times[0] + np.linspace(0, 0.8 * self.duration, _STARTS + 1)[1:]
        wide = self.half > 1 / self.duration
        offsets = np.linspace(-self.half, self.half, 5) if wide else np.zeros(1)
        points = [
            (self.hz + offset, d, start)
            for start in starts
            for d in self.decays
            if d * (self.duration - start + self.times[0]) > 0.7
            for offset in offsets
        ]
        if not points:
            return None
        _, (f, d, start) = max((self._energy(x), x) for x in points)
        return self._climbed((f, d, start), (0.2 / self.duration, 0.3 * d, self.duration / 60))

    def _frequencies(self, decay: float) -> list[float]:
        narrow = self.half <= 1 / self.duration
        n = 5 if narrow else int(2 * self.half / max(0.4 / self.duration, 0.15 * decay)) + 3
        return [float(f) for f in self.hz + self.half * np.linspace(-1, 1, n) if f > 0]

    def _bounded(self, x: np.ndarray) -> np.ndarray:
        hz = max(x[0], 0.1 / self.duration)
        return np.array([hz, min(abs(x[1]), 2 * np.pi * hz * _MOST_DAMPING), *x[2:]])

    def _energy(self, x: tuple[float, ...] | np.ndarray) -> float:
        hz, decay, *start = self._bounded(np.asarray(x, float))
        return explained(self.series, _columns(self.times, hz, decay, start[0] if start else self.times[0]))

    def _climbed(self, x: tuple[float, ...], scale: tuple[float, ...]) -> tuple[float, np.ndarray]:
        start, unit, n = np.array(x), np.array(scale), len(x)
        options = {
            "xatol": 1e-4,
            "fatol": 1e-6 * self._energy(start) + 1e-30,
            "maxiter": 250,
            "initial_simplex": np.vstack([np.zeros(n), np.eye(n)]),
        }
        found = optimize.minimize(
            lambda y: -self._energy(start + y * unit), np.zeros(n), method="Nelder-Mead", options=options
        )
        return -float(found.fun), self._bounded(start + found.x * unit)


def _decay_of(line: Vibration, series: np.ndarray, times_s: np.ndarray, first: float) -> Vibration:
    """The line with the decay that these samples say."""
    start = first if line.start_s is None else line.start_s
    found = optimize.minimize_scalar(
        lambda x: -explained(series, _columns(times_s, line.hz, float(np.exp(x)), start)),
        bounds=(np.log(line.decay) - 1.5, np.log(line.decay) + 1.1),
        method="bounded",
    )
    return Vibration(line.hz, float(np.exp(found.x)), line.start_s, line.kind)


def _with_deviations(
    line: Vibration, series: np.ndarray, times_s: np.ndarray, noise: float, whole: np.ndarray | None
) -> Vibration:
    """Deviations of nonlinear least squares, noise (JᵀJ)⁻¹; for white noise the Cramér-Rao bounds (Kay 1993)."""
    start = times_s[0] if line.start_s is None else line.start_s
    h = 1e-3 / (times_s[-1] - times_s[0])
    columns = _columns(times_s, line.hz, line.decay, start)
    fit = np.linalg.lstsq(columns, series, rcond=None)[0]
    now = columns @ fit
    slopes = [(_columns(times_s, line.hz + h, line.decay, start) @ fit - now) / h]
    if line.decay:
        slopes.append((_columns(times_s, line.hz, line.decay + h, start) @ fit - now) / h)
    jacobian = np.column_stack([columns, *slopes])

    def variance(rows: np.ndarray | slice, k: int) -> float:
        part = jacobian[rows]
        return float(np.linalg.pinv(part.T @ part)[k, k] * noise)

    every: slice = slice(None)
    of_decay = variance(every if whole is None else whole, 3) ** 0.5 if line.decay else 0.0
    return Vibration(line.hz, line.decay, line.start_s, line.kind, variance(every, 2) ** 0.5, of_decay)
