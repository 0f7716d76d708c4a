"""Samples at uneven times brought to an even clock: phones drop frames, and transforms of segments need even steps.

By a cubic spline, which is good up to a third of the rate. A long gap is filled by nothing.
"""

import numpy as np
from scipy.interpolate import CubicSpline

EVEN = 0.05  # of a step: what differs by less is rounding
LONGEST = 3.5  # steps from sample to sample
_CLOCK = 0.1  # of a step, by which even times may be off
_TAPS = 32  # samples that a delayed one takes part from; fewer miss what is near half the rate
_BETA = 4.0  # of their Kaiser window
_DECIMALS = 9  # of times, at most
_NEAR = 0.1  # of the last decimal


def is_filled(times_s: np.ndarray) -> bool:
    """Return whether no gap between times [T], which increase, is too long."""
    steps = np.diff(times_s)
    return bool(steps.max() <= LONGEST * np.median(steps))


def unrounded(times_s: np.ndarray) -> np.ndarray | None:
    """The even times [T] from which times, which do not fall, differ by the rounding of their last decimal; else None.

    Of a whole number of samples per second, where that is one of those; else by least squares.
    """
    steps, k = np.diff(times_s), np.arange(len(times_s))
    tick = _last_decimal(times_s)
    if not (tick > 0 and np.ptp(times_s) > 0 and steps.min() >= 0):
        return None
    centred = k - k.mean()
    step = float(centred @ (times_s - times_s[0]) / (centred @ centred))
    if abs(step / tick - 1) < _NEAR:  # a sample that lacks would look like rounding
        return None
    whole, independent = round(1 / step), np.ptp(times_s) / max(tick, step)
    if whole and np.ptp(times_s - k / whole) <= tick * 1.001:
        step = 1 / whole
    elif np.ptp(times_s - k * step) > tick * (1 + 2 / np.sqrt(independent)):
        return None
    return np.asarray(times_s[0] + np.mean(times_s - times_s[0] - k * step) + k * step)


def _last_decimal(times_s: np.ndarray) -> float:
    """Seconds, 0 where there are too many decimals to know."""
    for decimals in range(_DECIMALS + 1):
        scaled = times_s * 10.0**decimals
        if np.abs(scaled - np.round(scaled)).max() < 1e-4 and np.abs(scaled).max() < 1e11:
            return 10.0**-decimals
    return 0.0


def on_even_clock(times_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times [N] with even steps from the first to the last of times [T], and values [N, ...] there of values [T, ...].

    As they are, but for rounding of the times, where steps are even already.
    """
    if (even := unrounded(times_s)) is not None:
        return even, values
    steps = np.diff(times_s)
    if np.ptp(steps) <= EVEN * np.median(steps):
        return np.linspace(times_s[0], times_s[-1], len(times_s)), values
    usual = steps[np.abs(steps - np.median(steps)) <= np.median(steps) / 2].mean()
    count = round(float(np.ptp(times_s) / usual)) + 1
    even = np.linspace(times_s[0], times_s[-1], count)
    return even, np.asarray(CubicSpline(times_s, values)(even))


def is_even(times_s: np.ndarray) -> bool:
    """Return whether times [F] are evenly spaced, to a tenth of a frame; two always are."""
    if len(times_s) < 3:
        return True
    step = float(np.ptp(times_s)) / (len(times_s) - 1)
    even = times_s[0] + step * np.arange(len(times_s))
    return bool(np.abs(times_s - even).max() < _CLOCK * step)


def later(times_s: np.ndarray, functions: np.ndarray, seconds: float) -> np.ndarray:
    """Return functions [R, F] of times [F], so many seconds later.

    Uneven times are interpolated by a cubic spline, which is good up to a third of the frame rate.
    """
    if not seconds or not len(functions):
        return functions
    step = float(np.ptp(times_s)) / (len(times_s) - 1)
    if is_even(times_s):
        return delayed(functions, seconds / step)
    return np.asarray(CubicSpline(times_s, functions, axis=1)(times_s + seconds))


def delayed(functions: np.ndarray, frames: float) -> np.ndarray:
    """Return functions [R, F] of even times, so many frames later (Kaiser-windowed sinc; mirrored at the ends)."""
    offsets = np.arange(-_TAPS // 2, _TAPS // 2 + 1)
    away = frames - offsets
    inside = np.clip(1 - (away / (_TAPS / 2 + 1)) ** 2, 0, None)
    taps = np.sinc(away) * np.i0(_BETA * np.sqrt(inside)) / np.i0(_BETA)
    n = functions.shape[1]
    padded = np.pad(
        functions, ((0, 0), (_TAPS // 2, _TAPS // 2)), "reflect" if n > _TAPS // 2 else "symmetric"
    )
    return np.stack([np.convolve(f, taps[::-1], "valid") for f in padded])
