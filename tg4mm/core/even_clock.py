"""Samples at uneven times brought to an even clock: phones drop frames, and transforms of segments need even steps.

By a cubic spline, which is good up to a third of the rate. A long gap is filled by nothing.
"""

import numpy as np
from scipy.interpolate import CubicSpline

EVEN = 0.05  # of a step: what differs by less is rounding
LONGEST = 3.5  # steps from sample to sample


def is_filled(times_s: np.ndarray) -> bool:
    """Whether no gap between times [T], which increase, is too long."""
    steps = np.diff(times_s)
    return bool(steps.max() <= LONGEST * np.median(steps))


def on_even_clock(times_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times [N] with even steps from the first to the last of times [T], and values [N, ...] there of values [T, ...].

    As they are, but for rounding of the times, where steps are even already.
    """
    steps = np.diff(times_s)
    if np.ptp(steps) <= EVEN * np.median(steps):
        return np.linspace(times_s[0], times_s[-1], len(times_s)), values
    count = round(float(np.ptp(times_s) / np.median(steps))) + 1
    even = np.linspace(times_s[0], times_s[-1], count)
    return even, np.asarray(CubicSpline(times_s, values)(even))
