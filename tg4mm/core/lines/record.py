"""Lines of a spectrum, the record to which they are fitted, and the result in units of the values.

Noise is the residual of the fit around each line, at least the noise known to the caller, and need not be white:
deviations are the sandwich estimate (JᵀJ)⁻¹ JᵀΣJ (JᵀJ)⁻¹ (White 1980), with Σ from the residual's smoothed periodogram.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from tg4mm.core.lines.model import (
    LineShape,
    around,
    degrees,
    level,
    refined,
    samples,
    sandwiched,
    slopes,
    solved,
    spectra,
    trend,
)

_CYCLES, _FEWEST = 2, 12  # of a time constant, at least; samples in it
_RANGE = 0.25, 4.0  # times the decay
LEAST_CYCLES = 1.5  # of the record: slower is drift
FEWEST = 12  # samples from which there can be a line
LONG = 2000  # samples from which on neither slow changes nor beginnings of lines are looked for
# of the amplitude over the record, from which on a line decays, grows, or cannot be called steady
LEAST_CHANGE = 0.1
_ALIKE = 6  # components up to which their correlation is taken out
_TINY = 1e-12
_NEXT = 4  # of a modulation's cosines from which the slowest one is estimated
_KNOWN = 1000  # degrees of freedom of a level that is known from elsewhere


def tone(times_s: np.ndarray, hz: float) -> np.ndarray:
    """Return [T, 2]: cosine and sine."""
    angle = 2 * np.pi * hz * times_s
    return np.stack([np.cos(angle), np.sin(angle)], 1)


def alias(hz: float, rate: float) -> float:
    """Return the frequency below rate / 2 at which samples taken at `rate` Hz show `hz`."""
    return abs(hz - round(hz / rate) * rate)


def envelope(
    times_s: np.ndarray, decay_per_s: float, from_s: float, start_s: float | None = None
) -> np.ndarray:
    """Return [T]: exp(−decay (t − from_s)), 0 before `start_s`."""
    since = times_s - from_s
    if start_s is None:
        return np.asarray(np.exp(-decay_per_s * since))
    return np.where(times_s >= start_s - 1e-9, np.exp(-decay_per_s * np.maximum(since, 0)), 0.0)


@dataclass(frozen=True)
class Line:
    """u_d(t) = e(t) Re[phasor_d exp(i 2π f t)] with the envelope e(t) = exp(−decay (t − from_s)), 0 before `start_s`.

    `from_s` is where e(t) is 1: the line's first moment, of one that grows the last; so amplitudes are the largest of
    the record. The covariance is of (f, decay, Re q [D], Im q [D]) with q = phasor exp(i 2π f middle_s), the phasor at
    the middle of the line's energy, where phase and frequency are not correlated; decay has 0 where it is held at 0.
    """

    hz: float
    decay_per_s: float  # negative: grows; 0: held at 0, since no test says otherwise
    phasor: np.ndarray  # [D] complex, units of the values, by the record's own clock
    covariance: np.ndarray  # [2 + 2D, 2 + 2D]
    from_s: float
    middle_s: float
    start_s: float | None  # where it begins in the record, None: before it
    change: str  # "steady", "decays", "grows", "begins" (and then lasts or decays), "varies", "untold"
    strength: float  # χ² of its amplitudes, of 2D degrees of freedom
    modulation: float = (
        0.0  # rms of what its amplitude and phase (rad) change by beside that, relative; 0: none detected
    )

    @property
    def hz_deviation(self) -> float:
        """Standard deviation of the frequency, Hz."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def amplitude(self) -> np.ndarray:
        """Return [D] zero to peak, where the envelope is largest."""
        return np.abs(self.phasor)

    @property
    def amplitude_deviation(self) -> np.ndarray:
        """Return [D] standard deviation of each amplitude; of one hidden in noise that of its parts."""
        return np.sqrt(self._quadrature(np.exp(1j * np.angle(self.middle_phasor))))

    @property
    def phase_deviation(self) -> np.ndarray:
        """Return [D] radians, π at most, at `middle_s`."""
        across = np.sqrt(self._quadrature(1j * np.exp(1j * np.angle(self.middle_phasor))))
        return np.minimum(across / np.maximum(self.amplitude, 1e-300), np.pi)

    @property
    def middle_phasor(self) -> np.ndarray:
        """Return [D] q of the class's docstring."""
        return np.asarray(self.phasor * np.exp(2j * np.pi * self.hz * self.middle_s))

    @property
    def damping(self) -> float | None:
        """Damping ratio ζ = decay / √(decay² + (2π f)²); None unless a test says that the line decays."""
        if self.decay_per_s <= 0:
            return None
        return float(self.decay_per_s / np.hypot(self.decay_per_s, 2 * np.pi * self.hz))

    @property
    def damping_deviation(self) -> float | None:
        """Standard deviation of `damping`."""
        if (ratio := self.damping) is None:
            return None
        return float(ratio / self.decay_per_s * np.sqrt(self.covariance[1, 1]))

    def envelope(self, times_s: np.ndarray) -> np.ndarray:
        """Return [T], 1 at most in the record."""
        return envelope(times_s, self.decay_per_s, self.from_s, self.start_s)

    def columns(self, times_s: np.ndarray) -> np.ndarray:
        """Return [T, 2]: cosine and sine of the record's own clock times the envelope."""
        return self.envelope(times_s)[:, None] * tone(times_s, self.hz)

    def at(self, times_s: np.ndarray) -> np.ndarray:
        """Return [T, D] the line's own part of the series."""
        turning = self.envelope(times_s) * np.exp(2j * np.pi * self.hz * times_s)
        return np.asarray((turning[:, None] * self.phasor).real)

    def _quadrature(self, direction: np.ndarray) -> np.ndarray:
        """Return [D] variance of Re(q conj(direction))."""
        n = len(self.phasor)
        re, im = 2 + np.arange(n), 2 + n + np.arange(n)
        c, a, b = self.covariance, direction.real, direction.imag
        return np.maximum(a * a * c[re, re] + b * b * c[im, im] + 2 * a * b * c[re, im], 0)


@dataclass(frozen=True)
class Lines:
    """The result of `find_lines` and `fit_lines`."""

    lines: tuple[Line, ...]  # by falling strength; of `fit_lines` in the order asked for
    residual: np.ndarray  # [T, D] values less the lines, a constant and a slow trend
    hz: np.ndarray  # [F] of the noise
    noise: np.ndarray  # [F, D] its level: the standard deviation that white noise of the same density has


@dataclass(frozen=True)
class CodecChange:
    """The most that a video's codec may let a steady line grow or fade by over the record, as a logarithm.

    The share that it takes of a motion varies while it refines pictures: at most the share of detail that predicted
    frames lack, and at most the power that they lack.
    """

    most: float = 0.0
    size: float = np.inf  # amplitude of a line with that power, units of the values

    def of(self, amplitude: float) -> float:
        """Return it for a line of that amplitude."""
        return min(self.most, 0.5 * float(np.log1p((self.size / max(amplitude, 1e-300)) ** 2)))


@dataclass(frozen=True)
class Record:
    """Values whitened over components: their noise has equal variance and is uncorrelated."""

    t: np.ndarray  # [T] s
    y: np.ndarray  # [T, D]
    back: np.ndarray  # [D, D] y @ back are the values
    known: np.ndarray  # [D] least standard deviation of the values
    ends: tuple[float, float]
    chance: float = 0.01  # that noise alone makes a line in it
    codec: CodecChange = CodecChange()

    @staticmethod
    def of(
        values: np.ndarray,
        times_s: np.ndarray,
        noise: np.ndarray | float,
        ends: tuple[float, float] | None,
        chance: float = 0.01,
        codec: CodecChange | None = None,
    ) -> "Record | None":
        y = np.asarray(values, np.float64).reshape(len(values), -1)
        t = np.asarray(times_s, np.float64)
        if t.shape != y.shape[:1]:
            raise ValueError(f"values {np.shape(values)} and times {t.shape} do not belong together")
        if len(t) < FEWEST or not np.isfinite(y).all() or not np.ptp(y, axis=0).any():
            return None
        step = float(np.median(np.diff(t)))
        duration = float(np.ptp(t)) + step
        ends = ends or (LEAST_CYCLES / duration, 0.5 / step - 0.5 / duration)
        least = np.broadcast_to(np.asarray(noise, np.float64), y.shape[1:])
        own = codec or CodecChange()
        return Record(t, y, np.eye(y.shape[1]), least, ends, chance, own).whitened(())

    def whitened(self, shapes: Sequence[LineShape]) -> "Record":
        """Return the record in units of the noise that these lines leave; a strong line hides it before it is found."""
        forth = _whitening(solved(shapes, self.t, self.y)[1] @ self.back, self.t, self.known)
        return replace(self, y=self.y @ self.back @ forth, back=np.linalg.inv(forth))

    def coded_change(self, shape: LineShape, phasor: np.ndarray) -> float:
        """Return what a codec may let a line with that shape and phasor [D] change by, as a logarithm."""
        rms = float(np.sqrt((np.abs(shape.wave(self.t)) ** 2).mean()))
        return self.codec.of(rms * float(np.linalg.norm(phasor @ self.back)))

    def levels(self, shapes: Sequence[LineShape], residual: np.ndarray) -> np.ndarray:
        """Return the variance [F, D] of the noise around each bin, from the residual."""
        power = np.abs(spectra(residual, self.t)) ** 2
        taken = np.zeros(len(power))
        for s in shapes:
            taken[self.bin_of(s.hz, len(power))] += 1 + (1 + s.is_free) / (2 * self.y.shape[1])
        return np.maximum(around(power, taken + self._by_modulation(shapes, len(power))), self.least())

    def _by_modulation(self, shapes: Sequence[LineShape], n_bins: int) -> np.ndarray:
        """Return [F] share of each bin's power that the shapes' modulations took away with them."""
        taken = np.zeros(n_bins)
        for s in shapes:
            lasting = float(self.t[-1] - self.t[s.start])
            for off in (k / (2 * lasting) for k in s.rates):
                for hz in (s.hz - off, s.hz + off):
                    taken[self.bin_of(hz, n_bins)] += 1 / (4 * self.y.shape[1])
        return taken

    def folded(self, hz: float) -> float:
        """Return the alias of a frequency below half the sampling rate."""
        return alias(hz, 1 / float(np.median(np.diff(self.t))))

    def bin_of(self, hz: float, n_bins: int) -> int:
        """The row of a level [n_bins, D] that a frequency belongs to."""
        return int(np.clip(round(self.folded(hz) * float(np.ptp(self.t))) - 1, 0, n_bins - 1))

    def floor(self, residual: np.ndarray, shapes: Sequence[LineShape]) -> tuple[np.ndarray, int]:
        """Return the noise level [F, D], robust to lines that are still there, and its degrees of freedom.

        In a short record, whose bins one line may fill, it is the noise known from elsewhere, if any.
        """
        power = np.abs(spectra(residual, self.t)) ** 2
        if len(power) < FEWEST and (self.known > 0).all():
            return np.broadcast_to(self.least(), power.shape), _KNOWN
        left = np.maximum(1 - self._by_modulation(shapes, len(power)), 0.5)
        return np.maximum(level(power / left[:, None]), self.least()), degrees(len(power))

    def least(self) -> np.ndarray:
        """Return the least level [D]: the known noise, and rounding."""
        known = np.einsum("ij,i->j", np.linalg.inv(self.back) ** 2, self.known**2)
        return np.asarray(np.maximum(known, _TINY * (self.y**2).mean(0) + 1e-300))

    def result(self, shapes: Sequence[LineShape]) -> Lines:
        """Return the lines in the units of the values."""
        phasors, residual = solved(shapes, self.t, self.y)
        levels = self.levels(shapes, residual)
        errors = covariances(self, shapes, phasors, levels)
        free = _free_decays(self, shapes, levels)
        for s, p, c in zip(shapes, phasors, errors, strict=True):
            line = (s.wave(self.t)[:, None] * p).real
            c[1, 1] += early_decay_variance(s, self.t, line + residual, float(c[1, 1]))
        lines = tuple(
            self._line(s, p, c, d) for s, p, c, d in zip(shapes, phasors, errors, free, strict=True)
        )
        n = samples(self.t)
        hz = np.arange(1, len(levels) + 1) / (n * float(np.median(np.diff(self.t))))
        density = np.sqrt(levels @ self.back**2)
        return Lines(lines, residual @ self.back, hz, density)

    def _line(
        self, s: LineShape, phasor: np.ndarray, covariance: np.ndarray, free: tuple[float, float]
    ) -> Line:
        n = len(phasor)
        turn = np.eye(2 + 2 * n)
        turn[2 : 2 + n, 2 : 2 + n] = turn[2 + n :, 2 + n :] = self.back.T
        middle = s.middle_s(self.t)
        clock = (phasor @ self.back) * np.exp(-2j * np.pi * s.hz * middle)
        start = float(self.t[s.start]) if s.start else None
        errors = turn @ covariance @ turn.T
        strength = wald(phasor, covariance)
        change = _change(s, free, self.coded_change(s, phasor))
        return Line(s.hz, s.decay, clock, errors, s.from_s(self.t), middle, start, change, strength, s.depth)


def _change(s: LineShape, free: tuple[float, float], coded: float) -> str:
    if s.start:
        return "begins"
    if s.is_free:
        return "decays" if s.decay > 0 else "grows"
    varies = 0.0 if s.modulation is None else float(np.abs(s.modulation - 1).max())
    if varies > max(LEAST_CHANGE, -np.expm1(-coded)):
        return "varies"
    return "steady" if abs(free[0]) + 2 * free[1] < 2 * LEAST_CHANGE else "untold"


def _whitening(y: np.ndarray, t: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return [D, D] that whitens the components' noise, estimated away from the strongest bins."""
    spectrum = spectra(y, t)
    scatter = np.sqrt(np.median(np.abs(spectrum) ** 2, axis=0) / np.log(2))
    scatter = np.maximum(np.maximum(scatter, noise), 1e-9 * np.sqrt((y**2).mean()) + 1e-300)
    if not 1 < y.shape[1] <= _ALIKE:
        return np.diag(1 / scatter)
    scaled = spectrum / scatter
    power = (np.abs(scaled) ** 2).sum(1)
    quiet = scaled[power <= np.quantile(power, 0.7)]
    shared = (quiet.conj().T @ quiet).real
    size = np.sqrt(np.diag(shared)) + 1e-12 * np.sqrt(np.trace(shared)) + 1e-30
    alike = shared / np.outer(size, size) * (1 - 1e-3) + 1e-3 * np.eye(len(shared))
    return np.asarray(np.diag(1 / scatter) @ np.linalg.inv(np.linalg.cholesky(alike)).T)


def nothing(values: np.ndarray) -> Lines:
    """Return an empty result for a record too short to resolve any line."""
    y = np.asarray(values, np.float64).reshape(len(values), -1)
    return Lines((), y - y.mean(0), np.zeros(1), np.zeros((1, y.shape[1])))


def wald(phasor: np.ndarray, covariance: np.ndarray) -> float:
    """χ² of the hypothesis that there is no line."""
    parts = np.concatenate([phasor.real, phasor.imag])
    return float(parts @ np.linalg.pinv(covariance[2:, 2:], hermitian=True) @ parts)


def _free_decays(
    record: Record, shapes: Sequence[LineShape], levels: np.ndarray
) -> list[tuple[float, float]]:
    """Decay over the record and its deviation with it left free, of every line."""
    if not shapes:
        return []
    free = refined([replace(s, is_free=True) for s in shapes], record.t, record.y, record.ends)
    errors = covariances(record, free, solved(free, record.t, record.y)[0], levels)
    duration = float(np.ptp(record.t))
    return [
        (s.decay * duration, float(np.sqrt(c[1, 1])) * duration) for s, c in zip(free, errors, strict=True)
    ]


def covariances(
    record: Record, shapes: Sequence[LineShape], phasors: np.ndarray, levels: np.ndarray
) -> list[np.ndarray]:
    """Return [2 + 2D, 2 + 2D] of each line: Hz, decay per second, Re and Im of its phasor."""
    x, numbers = _jacobian(record, shapes, phasors)
    scale = np.sqrt((x**2).sum((0, 1))) + 1e-300
    x = x / scale
    flat = x.reshape(-1, x.shape[2])
    inverse = np.linalg.pinv(flat.T @ flat, rcond=1e-12, hermitian=True)
    whole = inverse @ sandwiched(x, levels, record.t) @ inverse / np.outer(scale, scale)
    out = []
    for s, rows in zip(shapes, numbers, strict=True):
        block = whole[np.ix_(rows, rows)]
        block[rows < 0], block[:, rows < 0] = 0, 0
        by_phase, by_size = _slow_variance(s, record.t)
        block[0, 0] += by_phase / (2 * np.pi) ** 2
        block[1, 1] += by_size * s.is_free
        out.append(block)
    return out


def _slow_variance(s: LineShape, t: np.ndarray) -> tuple[float, float]:
    """Return the variance that a modulation adds to a line's slopes: (rad / s)² of phase and 1 / s² of log amplitude.

    Half a cycle over the record, cos(πs), looks like a slope: −24 / π² of it. Its size is estimated from the next
    slowest cosines, assuming that sizes fall with 1 / k as those of a random walk do.
    """
    if s.modulation is None:
        return 0.0, 0.0
    since = (t[s.start :] - t[s.start]) / (t[-1] - t[s.start])
    modulation = s.modulation[s.start :] - 1
    k = np.arange(2, 2 + _NEXT)
    c = 2 * modulation @ np.cos(np.pi * since[:, None] * k) / len(since)
    scale = (24 / np.pi**2 / (t[-1] - t[s.start])) ** 2
    return scale * float((k * c.imag) @ (k * c.imag)) / _NEXT, scale * float(
        (k * c.real) @ (k * c.real)
    ) / _NEXT


def _jacobian(
    record: Record, shapes: Sequence[LineShape], phasors: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return [T, D, P] of all unknowns, and for each line which of them are its own; −1: a decay that is held."""
    each = np.eye(record.y.shape[1])
    columns: list[np.ndarray] = []
    numbers = []
    for s, p in zip(shapes, phasors, strict=True):
        first, bent, wave = len(columns), slopes(s, p, record.t), s.wave(record.t)
        columns += bent + [part[:, None] * unit for part in (wave.real, -wave.imag) for unit in each]
        of_phasor = np.arange(first + len(bent), len(columns))
        numbers.append(np.array([first, first + 1 if s.is_free else -1, *of_phasor]))
    columns += [slow[:, None] * unit for slow in trend(record.t).T for unit in each]
    return np.stack(columns, -1), numbers


def early_decay_variance(shape: LineShape, t: np.ndarray, values: np.ndarray, variance: float) -> float:
    """Return the variance to add to `variance` of a decay per second: 0 where both parts agree or one is too short.

    Video compression attenuates small motion, so the end of a ring-down looks weaker than it is, and the damping of
    real objects depends on amplitude. Neither is noise, so a least-squares fit's deviation lacks it.

    own [T, D]: the line plus the residual of all lines.
    """
    if not shape.is_free or shape.decay <= 0:
        return 0.0
    begin, constant = float(t[shape.start]), 1 / shape.decay
    early = (t >= begin) & (t <= begin + constant)
    if t[-1] < begin + 2 * constant or constant * shape.hz < _CYCLES or early.sum() < _FEWEST:
        return 0.0
    since, y = t - begin, values[t >= begin]
    whole = since[t >= begin]
    part, y_part = since[early], values[early]

    def left(log: float) -> float:
        basis = np.linalg.qr(_columns(shape.hz, float(np.exp(log)), part))[0]
        return -float(((basis.T @ y_part) ** 2).sum())

    bounds = tuple(np.log(shape.decay * np.array(_RANGE)))
    found = float(np.exp(minimize_scalar(left, bounds=bounds, method="bounded").x))
    information = [_information(shape, part, whole, y), _information(shape, whole, whole, y)]
    if information[0] <= 0:
        return 0.0
    # of nested samples' estimates, the variance of their difference is that of their variances
    apart = variance * max(information[1] / information[0] - 1, 0.0)
    return max((found - shape.decay) ** 2 - apart, 0.0)


def _columns(hz: float, decay: float, since: np.ndarray) -> np.ndarray:
    turning = np.exp((2j * np.pi * hz - decay) * since)
    return np.stack([turning.real, -turning.imag], 1)


def _information(shape: LineShape, since: np.ndarray, whole: np.ndarray, y: np.ndarray) -> float:
    """Return the information on the decay in samples at `since` of the line fitted to `y` at `whole`, noise units."""
    weights = np.linalg.lstsq(_columns(shape.hz, shape.decay, whole), y, rcond=None)[0]
    columns = _columns(shape.hz, shape.decay, since)
    basis = np.linalg.qr(columns)[0]
    slope = -since[:, None] * (columns @ weights)
    return float(((slope - basis @ (basis.T @ slope)) ** 2).sum())
