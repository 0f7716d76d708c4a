"""Spectrum of a motion: from temporal components and their fields to modes, one phasor per Gaussian and frequency.

A capture seldom contains an integer number of periods. Then a sinusoid leaks into all bins of a Fourier transform, so a
band around it contains only a part, and the mean over time is not the motion's zero. A trend leaks likewise. So the
components are fitted by sinusoids, a constant and, where it helps, a slow trend; the frequencies are lines of
`tg4mm.core.lines`. Where bins describe the motion as well, no sinusoids are used.

Sinusoids are fitted at the times of the frames, which need not be even: phones drop frames. Bins belong to the even
clock of these times, on which the residual of the sinusoids is interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from scipy.interpolate import PchipInterpolator

from tg4mm.core.lines import FEWEST, find_lines
from tg4mm.core.lines.band import tone_in

ALL_BINS_UP_TO = 64  # timesteps: of longer captures the weakest bins are dropped
_DROPPED = 1e-4  # of the motion's power at most, 1 % of its rms
TREND_CYCLES = 0.05  # per capture: a sine so slow that it is a straight line within half a percent
_MOST = 8  # sinusoids
_WEAKEST = 1e-4  # of the power: weaker sinusoids stay in the bins
# that BIC is to give for sinusoids against as many bins and one (Kass & Raftery 1995: very strong)
_EVIDENCE = 10.0
_APART = 0.75  # bins between sinusoids and to half the frame rate; the lowest is a bin less this tolerance
_STANDS_OUT = 6.0  # times the root of what noise of a sample has: a line's power from which it is found
_LEADING, _NOTHING = 6, 1e-6  # components that lines are looked for in, the strongest; of the strongest
_ON_BIN = 0.01  # bins: nearer than this is snapped to the bin
_ROUNDED = 1e-3  # of a frame: files round times to so much


def sinusoids(times_s: np.ndarray, freqs_hz: np.ndarray) -> np.ndarray:
    """Return [2K, F]: cos 2πf_k t and −sin 2πf_k t in pairs: Re[m exp(i 2πf t)] = Re m · row 2k + Im m · row 2k + 1."""
    angles = 2 * np.pi * np.asarray(freqs_hz)[:, None] * times_s
    return np.stack([np.cos(angles), -np.sin(angles)], 1).reshape(-1, len(times_s))


def polynomials(times_s: np.ndarray, degree: int) -> np.ndarray:
    """Return [F, degree + 1]: Legendre polynomials over the record."""
    span = max(float(np.ptp(times_s)), 1e-12)
    return np.asarray(legendre.legvander(2 * (times_s - times_s.min()) / span - 1, degree))


def constant_and_trend(times_s: np.ndarray) -> np.ndarray:
    """Return [2, F]."""
    return np.stack([np.ones_like(times_s), times_s - times_s.mean()])


def residual(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Series y [F, S] less their least-squares fit by functions of time x [F, P]."""
    return np.asarray(y - x @ np.linalg.lstsq(x, y, rcond=None)[0])


def modes_of(
    basis: np.ndarray,
    fields: np.ndarray,
    fps: float,
    appearance: np.ndarray | None = None,
    band: tuple[float, float] | None = None,
    times_s: np.ndarray | None = None,
    known_hz: Sequence[float] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [K] in Hz, ascending, and phasors [K, R] of the temporal components a_r(t) of Σ_r a_r(t) fields[r].

    basis [R, F], fields [R, N, D], appearance [R, ...]: fields of colour that share the components. times_s [F]: of the
    frames, in seconds, timestep 0 being the first; None: F even ones. known_hz: of steady vibrations, however weak in
    the mean over the scene: each is a sinusoid, or the bin that it lies on.
    Σ_k Re[m_k exp(i 2π f_k t / fps)] reconstructs the motion at every timestep, less its mean over time, which is the
    residuals pose. The frequencies are all DFT bins above 0. Where the motion has sinusoids between bins or a trend
    (`find_sinusoids`) these come on top, and the bins hold the residual: the sinusoids; a frequency of 0.05 bins, the
    trend from timestep 0 on; and 0 Hz, the offset from the mean over time to the motion's own zero, which is never
    magnified. Of more than 64 timesteps the weakest bins are dropped, 1e-4 of the power together; in it motion and
    appearance weigh the same. Where a `band` (Hz) is given and holds no frequency, the tone in it is one.
    """
    clock = FrameClock.of(basis.shape[1] if times_s is None else times_s * fps)
    n_timesteps = clock.length
    basis = basis - basis.mean(1, keepdims=True)
    products = np.einsum("rnc,snc->rs", fields[..., :3], fields[..., :3], dtype=np.float64)
    weighted = basis * np.sqrt(np.diag(products))[:, None]
    sinusoids = _with_known(
        find_sinusoids(weighted, clock), np.array(known_hz) * n_timesteps / fps, n_timesteps
    )
    if band is not None:
        sinusoids = _with_band(sinusoids, weighted, clock, fps, band)
    cycles, series = _with_bins(basis, sinusoids, clock)
    if appearance is not None and appearance.any():
        flat = appearance.reshape(len(appearance), -1).astype(np.float64)
        gram = flat @ flat.T
        products = products / max(np.trace(products), 1e-30) + gram / np.trace(gram)
    power = np.einsum("kr,rs,ks->k", series.conj(), products, series).real
    oscillates = cycles >= 1
    dropped = _DROPPED * power[oscillates].sum() if n_timesteps > ALL_BINS_UP_TO else -1.0
    keep = all_but_weakest(power, oscillates, dropped) | np.isin(cycles, sinusoids.cycles)
    return cycles[keep] * fps / n_timesteps, series[keep]


def _with_known(sinusoids: "Sinusoids", cycles: np.ndarray, n_timesteps: int) -> "Sinusoids":
    """Add frequencies that are far enough from the present ones and from half the frame rate."""
    for known in cycles:
        ends = np.append(sinusoids.cycles, n_timesteps / 2)
        if known >= 1 - _ON_BIN and np.abs(ends - known).min() >= _APART:
            sinusoids = replace(sinusoids, cycles=np.sort(np.append(sinusoids.cycles, known)))
    return _on_bins(sinusoids)


def _with_band(
    sinusoids: "Sinusoids", series: np.ndarray, clock: "FrameClock", fps: float, band: tuple[float, float]
) -> "Sinusoids":
    """Add the tone of series [R, F] in the band (Hz), if it contains no bin and no sinusoid."""
    n_timesteps = clock.length
    hz = np.append(sinusoids.cycles, np.arange(1, n_timesteps // 2 + 1)) * fps / n_timesteps
    if ((hz >= band[0]) & (hz <= band[1])).any():
        return sinusoids
    tone = tone_in(series.T, clock.frames / fps, band)
    return replace(sinusoids, cycles=np.sort(np.append(sinusoids.cycles, tone.hz * n_timesteps / fps)))


def _with_bins(
    basis: np.ndarray, sinusoids: "Sinusoids", clock: "FrameClock"
) -> tuple[np.ndarray, np.ndarray]:
    """Cycles per capture [K], ascending, and phasors [K, R] of functions of time [R, F]."""
    n_timesteps = clock.length
    spectrum: dict[float, np.ndarray] = {}
    if len(sinusoids.cycles) or sinusoids.trend:
        x = sinusoids.regressors(clock.shares)
        weights = np.linalg.lstsq(x, basis.T, rcond=None)[0]
        basis = basis - (x @ weights).T
        spectrum = _sinusoid_phasors(sinusoids, weights)
    bins = np.fft.rfft(clock.even(basis.T), axis=0) * (2 / n_timesteps)
    if n_timesteps % 2 == 0:
        bins[-1] /= 2  # the Nyquist bin has no mirror image
    for k in range(1, len(bins)):
        spectrum[k] = spectrum.get(k, 0) + bins[k]
    cycles = np.array(sorted(spectrum), np.float64)
    return cycles, np.stack([spectrum[c] for c in cycles])


def _sinusoid_phasors(sinusoids: "Sinusoids", weights: np.ndarray) -> dict[float, np.ndarray]:
    """Phasors [R] by cycles per capture, from the weights [P, R] of the regressors."""
    n, first = len(sinusoids.cycles), 1 + sinusoids.trend
    out = {0.0: weights[0].astype(complex)}  # a cos + b sin = Re[(a − i b) exp(i …)]
    if sinusoids.trend:
        out[TREND_CYCLES] = -1j * weights[1]
    for j, cycle in enumerate(sinusoids.cycles):
        out[float(cycle)] = weights[first + j] - 1j * weights[first + n + j]
    return out


def all_but_weakest(power: np.ndarray, some: np.ndarray, allowed: float) -> np.ndarray:
    """Return [K] bool: all but the weakest of `some` [K] bool, whose power [K] is together at most `allowed`."""
    weakest = np.flatnonzero(some)[np.argsort(power[some], kind="stable")]
    keep = np.full(len(power), True)
    keep[weakest[np.cumsum(power[weakest]) <= allowed]] = False
    return keep


@dataclass(frozen=True)
class FrameClock:
    """Times of F frames, in frames since the first, and their even clock."""

    frames: np.ndarray  # [F] float64
    length: int  # T of the even clock, from the first frame to the last

    @staticmethod
    def of(frames: np.ndarray | int) -> "FrameClock":
        """Make those of F frames, or of times [F] in frames."""
        if isinstance(frames, int):
            return FrameClock(np.arange(frames, dtype=np.float64), frames)
        since = frames - frames[0]
        whole = np.round(since)
        since = np.where(np.abs(since - whole) < _ROUNDED, whole, since)
        return FrameClock(since, int(whole[-1]) + 1)

    @property
    def shares(self) -> np.ndarray:
        """Return [F]: parts of the capture that are over."""
        return self.frames / self.length

    def even(self, y: np.ndarray) -> np.ndarray:
        """Return series [F, S] at every step of the clock, [T, S], interpolated without overshoot at missing frames."""
        if len(self.frames) == self.length and not (self.frames % 1).any():
            return y
        return np.asarray(PchipInterpolator(self.frames, y)(np.arange(self.length)))


@dataclass(frozen=True)
class Sinusoids:
    """Frequencies in bins (cycles per capture), ascending, and whether there is a trend beside them."""

    cycles: np.ndarray  # [J] float64
    trend: bool = False

    def regressors(self, t: np.ndarray) -> np.ndarray:
        """Return [F, P] at parts t [F] of the capture: a constant, the trend if any (zero at 0), cosines, sines."""
        angles = 2 * np.pi * t[:, None] * self.cycles
        slow = [np.sin(2 * np.pi * TREND_CYCLES * t)[:, None]] if self.trend else []
        return np.hstack([np.ones((len(t), 1)), *slow, np.cos(angles), np.sin(angles)])

    def residual_power(self, y: np.ndarray, clock: FrameClock) -> float:
        """Return the power that least squares leave of series y [F, R]."""
        return float((residual(y, self.regressors(clock.shares)) ** 2).sum())


def find_sinusoids(series: np.ndarray, clock: FrameClock | None = None) -> Sinusoids:
    """The sinusoids that real series [R, F], weighted by their power, share; the mean over time is removed first.

    They are the lines of `tg4mm.core.lines`. None where Fourier bins describe the series as well.
    """
    y = (series - series.mean(1, keepdims=True)).T
    clock = clock or FrameClock.of(len(y))
    power = float((y**2).sum())
    none = Sinusoids(np.zeros(0))
    if len(y) < FEWEST or not power > 0:
        return none
    plain = Sinusoids(_cycles(y, clock))
    with_trend = replace(plain, trend=True)
    unexplained, trend_unexplained = plain.residual_power(y, clock), with_trend.residual_power(y, clock)
    sinusoids = plain
    if _is_better(trend_unexplained, unexplained, power, len(y)):
        sinusoids, unexplained = with_trend, trend_unexplained
    every = clock.even(y)
    by_bins = np.sort((np.abs(np.fft.rfft(every, axis=0)) ** 2).sum(1))[::-1] * 2 / len(every)
    left = float(np.maximum((every**2).sum() - by_bins[: len(sinusoids.cycles) + 1].sum(), 0))
    bins_unexplained = left * len(y) / len(every)
    return _on_bins(sinusoids) if _is_better(unexplained, bins_unexplained, power, len(y)) else none


def _cycles(y: np.ndarray, clock: FrameClock) -> np.ndarray:
    """Return [J] lines of series [F, R], ascending, apart from each other and from half the frame rate."""
    ends = 1 - _ON_BIN, clock.length / 2 - _APART
    left, strength, _ = np.linalg.svd(y, full_matrices=False)
    leading = (left * strength)[:, : min(_LEADING, int((strength > _NOTHING * strength[0]).sum()))]
    noise = np.sqrt(_WEAKEST * (strength**2).sum()) / _STANDS_OUT
    cycles = np.zeros(0)
    for line in find_lines(leading, clock.shares, noise, ends, _MOST).lines:
        if not len(cycles) or np.abs(cycles - line.hz).min() >= _APART:
            cycles = np.append(cycles, line.hz)
    return np.sort(cycles)


def _is_better(unexplained: float, others: float, power: float, n_frames: int) -> bool:
    """Return whether one description leaves less of the power than another of no fewer parameters does, by BIC."""
    if others - unexplained <= _WEAKEST * power:
        return False
    return n_frames * np.log(others / max(unexplained, 1e-300)) > _EVIDENCE


def _on_bins(sinusoids: Sinusoids) -> Sinusoids:
    cycles, near = sinusoids.cycles, np.round(sinusoids.cycles)
    return Sinusoids(np.where(np.abs(cycles - near) < _ON_BIN, near, cycles), sinusoids.trend)
