"""Shapes of lines as functions of time, and their least-squares fit by variable projection.

Frequencies and decays are nonlinear, phasors, a constant and a slow trend linear; these are projected out of each step
(Golub & Pereyra 1973, in Kaufman's form).

The noise around lines: its level over frequency, and the covariance that it gives a least-squares fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.optimize import least_squares

TREND = 2  # degree of the polynomial beside the lines
_FURTHEST = 0.75  # over the duration, Hz: what a refinement may move a frequency by
_STEEPEST = 0.5  # damping ratio
_GROWS = 8.0  # e-foldings over the record, at most
_STEPS = 25
AROUND = 6  # bins to either side of a line whose residual gives its noise
_WIDEST, _NARROWEST = (
    40,
    8,
)  # bins to either side from which the level is estimated where lines are looked for
_TRIMMED = 0.2  # of the bins, the strongest: lines that are still there
_ROUNDING = 1e-14  # of the power
_CLIPS, _ENOUGH = 8, 20  # times that peaks are left out of the noise; frequencies that a parabola needs


@dataclass(frozen=True)
class LineShape:
    """The nonlinear parameters of a line."""

    hz: float
    decay: float = 0.0  # per second
    start: int = 0  # sample from which on it is there
    is_free: bool = False  # whether the decay is fitted
    # of its modulation, half cycles in its part of the record (`modulation.py`)
    rates: tuple[float, ...] = ()
    pairs: tuple[float, ...] = ()  # Hz, of sidebands that were seen
    modulation: np.ndarray | None = field(default=None, compare=False)  # [T] complex, of mean 1; None: 1

    def from_s(self, t: np.ndarray) -> float:
        """Return the time at which the envelope is 1."""
        return float(t[self.start] if self.decay >= 0 else t[-1])

    def envelope(self, t: np.ndarray) -> np.ndarray:
        """Return [T]."""
        e = np.exp(-self.decay * (t - self.from_s(t)))
        e[: self.start] = 0
        return e

    @property
    def depth(self) -> float:
        """Rms of the modulation."""
        return 0.0 if self.modulation is None else float(np.sqrt((np.abs(self.modulation - 1) ** 2).mean()))

    def middle_s(self, t: np.ndarray) -> float:
        """Return the centre of the line's energy in time."""
        power = self.envelope(t) ** 2
        return float(power @ t / power.sum())

    def wave(self, t: np.ndarray) -> np.ndarray:
        """Return [T] complex, phase 0 at `middle_s`."""
        e = self.envelope(t)
        middle = float((power := e**2) @ t / power.sum())
        if self.modulation is not None:
            e = e * self.modulation
        return e * np.exp(2j * np.pi * self.hz * (t - middle))


def trend(t: np.ndarray) -> np.ndarray:
    """Return [T, TREND + 1]."""
    return np.asarray(legendre.legvander(2 * (t - t[0]) / max(np.ptp(t), 1e-12) - 1, TREND))


def design(shapes: Sequence[LineShape], t: np.ndarray) -> np.ndarray:
    """Return [T, TREND + 1 + 2K]: the trend, then Re and −Im of each wave in turn."""
    return _columns([s.wave(t) for s in shapes], trend(t))


def _columns(waves: Sequence[np.ndarray], slow: np.ndarray) -> np.ndarray:
    out = np.empty((len(slow), slow.shape[1] + 2 * len(waves)))
    out[:, : slow.shape[1]] = slow
    for k, w in enumerate(waves):
        out[:, slow.shape[1] + 2 * k], out[:, slow.shape[1] + 2 * k + 1] = w.real, -w.imag
    return out


def solved(shapes: Sequence[LineShape], t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phasors [K, D] at each wave's middle, and the residual [T, D], of least squares."""
    x = design(shapes, t)
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    pairs = weights[TREND + 1 :]
    return pairs[0::2] + 1j * pairs[1::2], y - x @ weights


def slopes(
    shape: LineShape, phasor: np.ndarray, t: np.ndarray, wave: np.ndarray | None = None
) -> list[np.ndarray]:
    """Return [T, D] derivatives of a line by its frequency and, if that is free, its decay. wave: `shape.wave(t)`."""
    turning = (shape.wave(t) if wave is None else wave)[:, None] * phasor
    by_hz = (2j * np.pi * (t - shape.middle_s(t))[:, None] * turning).real
    if not shape.is_free:
        return [by_hz]
    return [by_hz, -((t - shape.from_s(t))[:, None] * turning).real]


def refined(
    shapes: Sequence[LineShape], t: np.ndarray, y: np.ndarray, ends: tuple[float, float]
) -> list[LineShape]:
    """The shapes moved to the least squares of y [T, D], frequencies by 0.75 / duration at most and within `ends`."""
    duration = float(np.ptp(t)) or 1.0
    scale = float(np.sqrt((y**2).sum())) or 1.0
    start, low, high = [], [], []
    for s in shapes:
        span = max(_FURTHEST, abs(s.decay) * duration / np.pi)
        start.append(s.hz * duration)
        low.append(max(s.hz * duration - span, ends[0] * duration))
        high.append(min(s.hz * duration + span, ends[1] * duration))
        if s.is_free:
            start.append(s.decay * duration)
            low.append(-_GROWS if s.start == 0 else 0.0)
            high.append(2 * np.pi * _STEEPEST * max(s.hz * duration, 1.0))
    bounds = np.array(low), np.maximum(high, np.array(low) + 3e-9)
    margin = 1e-9 * (1 + np.abs(bounds[1]))

    slow = trend(t)

    @lru_cache(1)  # the Jacobian is asked for where the misfit was
    def factored(x: tuple[float, ...]) -> tuple[list[LineShape], list[np.ndarray], np.ndarray, np.ndarray]:
        moved = _with(shapes, x, duration)
        waves = [s.wave(t) for s in moved]
        basis, upper = np.linalg.qr(_columns(waves, slow))
        return moved, waves, basis, upper

    def misfit(x: np.ndarray) -> np.ndarray:
        basis = factored(tuple(x))[2]
        return (y - basis @ (basis.T @ y)).ravel() / scale

    def jacobian(x: np.ndarray) -> np.ndarray:
        moved, waves, basis, upper = factored(tuple(x))
        weights = np.linalg.lstsq(upper, basis.T @ y, rcond=None)[0][slow.shape[1] :]
        phasors = weights[0::2] + 1j * weights[1::2]
        each = zip(moved, phasors, waves, strict=True)
        columns = [c for s, p, w in each for c in slopes(s, p, t, w)]
        return np.stack([-(c - basis @ (basis.T @ c)).ravel() for c in columns], 1) / (duration * scale)

    x0 = np.clip(start, bounds[0] + 1e-9, np.maximum(bounds[1] - margin, bounds[0] + 1e-9))
    found = least_squares(
        misfit, x0, jacobian, bounds=bounds, x_scale="jac",
        xtol=1e-8, ftol=1e-9, max_nfev=_STEPS,
    )  # fmt: skip
    return _with(shapes, found.x, duration)


def _with(shapes: Sequence[LineShape], x: Sequence[float] | np.ndarray, duration: float) -> list[LineShape]:
    out, k = [], 0
    for s in shapes:
        decay = s.decay
        if s.is_free:
            decay = float(x[k + 1] / duration)
        out.append(replace(s, hz=float(x[k] / duration), decay=decay))
        k += 1 + s.is_free
    return out


def gridded(values: np.ndarray, t: np.ndarray, length: int) -> np.ndarray:
    """Return values [T, D] on an even clock [length, D], 0 where a sample is missing."""
    step = float(np.median(np.diff(t)))
    out = np.zeros((length, values.shape[1]))
    np.add.at(out, np.minimum(np.rint((t - t[0]) / step).astype(int), length - 1), values)
    return out


def samples(t: np.ndarray) -> int:
    """Return the number of samples of the even clock that the times lie on."""
    return round(float(np.ptp(t)) / float(np.median(np.diff(t)))) + 1


def spectra(values: np.ndarray, t: np.ndarray) -> NDArray[np.complex128]:
    """Return [F, D] at bins 1 … F below half the rate; |·|² is the variance of white noise."""
    n = samples(t)
    return np.fft.rfft(gridded(values, t, n), axis=0)[1 : (n + 1) // 2] / np.sqrt(len(t))


def level(power: np.ndarray) -> np.ndarray:
    """Return the level [F, D] of the noise in power [F, D]: a smooth fall with frequency, times a local trimmed mean.

    The strongest fifth of the bins is left out, as lines may be, and what exponentially distributed power loses by
    that is made up for.
    """
    floor = np.maximum(power, _ROUNDING * max(float(power.max(initial=0)), 1e-300))
    bins = np.arange(1, len(power) + 1)
    half = int(np.clip(len(power) // 6, min(_NARROWEST, len(power) // 2), _WIDEST))
    out = np.empty_like(floor)
    for d in range(power.shape[1]):
        few = len(power) < 3 * _NARROWEST
        fall = (
            floor[:, d].mean() if few else np.exp(log_floor(floor[:, d], bins, np.ones(len(power), bool))[0])
        )
        padded = np.pad(floor[:, d] / fall, half, mode="reflect") if half else floor[:, d] / fall
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
        kept = max(int(np.ceil((1 - _TRIMMED) * windows.shape[1])), 1)
        out[:, d] = np.sort(windows, axis=1)[:, :kept].mean(1) / _trimmed_mean(kept / windows.shape[1]) * fall
    return out


def degrees(n_bins: int) -> int:
    """Return the approximate degrees of freedom of `level`."""
    half = int(np.clip(n_bins // 6, min(_NARROWEST, n_bins // 2), _WIDEST))
    return max(int(2 * (1 - _TRIMMED) * (2 * half + 1)), 2)


def _trimmed_mean(share: float) -> float:
    """Return the mean of the weakest `share` of exponentially distributed numbers of mean 1."""
    if share >= 1:
        return 1.0
    return float(1 + (1 - share) * np.log(1 - share) / share)


def log_floor(power: np.ndarray, hz: np.ndarray, allowed: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the log of the noise's power [M], a parabola over log frequency, and the robust deviation from it.

    It is fitted to the `allowed` frequencies [M] bool. Peaks are clipped: what lies more than two deviations above is
    left out, and the rest is fitted again.
    """
    x, y = np.log(hz / hz[0]), np.log(np.maximum(power, _ROUNDING * power.max() + 1e-300))
    kept, spread = allowed, 0.0
    fitted = np.full(len(y), float(np.median(y[allowed])))
    for k in range(_CLIPS):
        if k:
            fitted = np.polyval(np.polyfit(x[kept], y[kept], 2 if kept.sum() > _ENOUGH else 0), x)
        above, before = y - fitted, kept
        spread = 1.4826 * float(np.median(np.abs(above[kept])))
        kept = allowed & (above < max(2 * spread, 1e-6))
        if k and (kept == before).all():
            break
    return fitted, spread


def around(power: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return the mean of power [F, D] over 2·6 + 1 bins, scaled up by the degrees of freedom that the fit took."""
    half = min(AROUND, max((len(power) - 1) // 2, 0))
    kernel = np.ones(2 * half + 1)

    def summed(v: np.ndarray) -> np.ndarray:
        return np.convolve(np.pad(v, half, mode="reflect") if half else v, kernel, "valid")

    left = np.maximum(summed(1 - taken), 1.0)
    return np.stack([summed(p) / left for p in power.T], 1)


def sandwiched(columns: np.ndarray, levels: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return [P, P] XᵀΣX of columns X [T, D, P] for noise of level [F, D], not correlated between components."""
    n = samples(t)
    out = np.zeros((columns.shape[2],) * 2)
    for d in range(columns.shape[1]):
        spectrum = np.fft.rfft(gridded(columns[:, d], t, 2 * n), axis=0)
        hz = np.arange(len(spectrum)) / 2  # bins
        density = np.interp(hz, np.arange(1, len(levels) + 1), levels[:, d])
        twice = np.where((hz == 0) | (hz == n / 2), 1.0, 2.0)  # the mirror image
        weighted = spectrum * (density * twice)[:, None]
        out += (spectrum.conj().T @ weighted).real / (2 * n)
    return out
