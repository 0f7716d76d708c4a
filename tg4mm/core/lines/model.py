"""Shapes of lines as functions of time, and their least squares by variable projection.

Frequencies and decays are nonlinear, phasors, a constant and a slow trend linear; these are projected out of each step
(Golub & Pereyra 1973, in Kaufman's form).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from scipy.optimize import least_squares

TREND = 2  # degree of the polynomial beside the lines
_FURTHEST = 0.75  # over the duration, Hz: what a refinement may move a frequency by
_STEEPEST = 0.5  # damping ratio
_GROWS = 8.0  # e-foldings over the record, at most
_STEPS = 25


@dataclass(frozen=True)
class Shape:
    """What of a line is not linear."""

    hz: float
    decay: float = 0.0  # per second
    start: int = 0  # sample from which on it is there
    is_free: bool = False  # whether the decay is fitted

    def from_s(self, t: np.ndarray) -> float:
        """Where its envelope is 1."""
        return float(t[self.start] if self.decay >= 0 else t[-1])

    def envelope(self, t: np.ndarray) -> np.ndarray:
        """[T]."""
        e = np.exp(-self.decay * (t - self.from_s(t)))
        e[: self.start] = 0
        return e

    def middle_s(self, t: np.ndarray) -> float:
        """The middle of its energy."""
        power = self.envelope(t) ** 2
        return float(power @ t / power.sum())

    def wave(self, t: np.ndarray) -> np.ndarray:
        """[T] complex, phase 0 at `middle_s`."""
        e = self.envelope(t)
        middle = float((power := e**2) @ t / power.sum())
        return e * np.exp(2j * np.pi * self.hz * (t - middle))


def trend(t: np.ndarray) -> np.ndarray:
    """[T, TREND + 1]."""
    return np.asarray(legendre.legvander(2 * (t - t[0]) / max(np.ptp(t), 1e-12) - 1, TREND))


def design(shapes: Sequence[Shape], t: np.ndarray) -> np.ndarray:
    """[T, TREND + 1 + 2K]: the trend, then Re and −Im of each wave in turn."""
    return _columns([s.wave(t) for s in shapes], trend(t))


def _columns(waves: Sequence[np.ndarray], slow: np.ndarray) -> np.ndarray:
    out = np.empty((len(slow), slow.shape[1] + 2 * len(waves)))
    out[:, : slow.shape[1]] = slow
    for k, w in enumerate(waves):
        out[:, slow.shape[1] + 2 * k], out[:, slow.shape[1] + 2 * k + 1] = w.real, -w.imag
    return out


def solved(shapes: Sequence[Shape], t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phasors [K, D] at each wave's middle, and the residual [T, D], of least squares."""
    x = design(shapes, t)
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    own = weights[TREND + 1 :]
    return own[0::2] + 1j * own[1::2], y - x @ weights


def slopes(
    shape: Shape, phasor: np.ndarray, t: np.ndarray, wave: np.ndarray | None = None
) -> list[np.ndarray]:
    """[T, D] derivatives of a line by its frequency and, if that is free, its decay. wave: `shape.wave(t)`."""
    turning = (shape.wave(t) if wave is None else wave)[:, None] * phasor
    by_hz = (2j * np.pi * (t - shape.middle_s(t))[:, None] * turning).real
    if not shape.is_free:
        return [by_hz]
    return [by_hz, -((t - shape.from_s(t))[:, None] * turning).real]


def refined(shapes: Sequence[Shape], t: np.ndarray, y: np.ndarray, ends: tuple[float, float]) -> list[Shape]:
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

    def misfit(x: np.ndarray) -> np.ndarray:
        basis = np.linalg.qr(_columns([s.wave(t) for s in _with(shapes, x, duration)], slow))[0]
        return (y - basis @ (basis.T @ y)).ravel() / scale

    def jacobian(x: np.ndarray) -> np.ndarray:
        own = _with(shapes, x, duration)
        waves = [s.wave(t) for s in own]
        basis, upper = np.linalg.qr(_columns(waves, slow))
        weights = np.linalg.lstsq(upper, basis.T @ y, rcond=None)[0][slow.shape[1] :]
        phasors = weights[0::2] + 1j * weights[1::2]
        each = zip(own, phasors, waves, strict=True)
        columns = [c for s, p, w in each for c in slopes(s, p, t, w)]
        return np.stack([-(c - basis @ (basis.T @ c)).ravel() for c in columns], 1) / (duration * scale)

    x0 = np.clip(start, bounds[0] + 1e-9, np.maximum(bounds[1] - margin, bounds[0] + 1e-9))
    found = least_squares(
        misfit, x0, jacobian, bounds=bounds, x_scale="jac",
        xtol=1e-8, ftol=1e-9, max_nfev=_STEPS,
    )  # fmt: skip
    return _with(shapes, found.x, duration)


def _with(shapes: Sequence[Shape], x: np.ndarray, duration: float) -> list[Shape]:
    out, k = [], 0
    for s in shapes:
        decay = s.decay
        if s.is_free:
            decay = float(x[k + 1] / duration)
        out.append(replace(s, hz=float(x[k] / duration), decay=decay))
        k += 1 + s.is_free
    return out
