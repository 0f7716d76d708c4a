"""Amplitude over frequency of a splat file's modes: how strong each is, which are peaks, the band round one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

PEAK_ABOVE = 0.05  # of the largest amplitude
MOST_PEAKS = 6


def rms_amplitude(amplitudes: np.ndarray, weights: np.ndarray) -> float:
    """√(Σ w a² / Σ w) of amplitudes [N] with weights [N]: 0 or more; plain rms where all weights are 0."""
    a, w = np.asarray(amplitudes, np.float64), np.asarray(weights, np.float64)
    return float(np.sqrt((w * a**2).sum() / w.sum() if w.sum() > 0 else (a**2).mean()))


def peaks(freqs_hz: Sequence[float], amplitudes: Sequence[float]) -> list[int]:
    """Numbers of the modes that are peaks, by frequency: no neighbour is larger, and none too small to matter.

    At most MOST_PEAKS, the largest. Of neighbours alike the lower counts.
    """
    order = np.argsort(freqs_hz, kind="stable")
    a = np.concatenate([[-1.0], np.asarray(amplitudes, float)[order], [-1.0]])
    inner = a[1:-1]
    found = (inner > a[:-2]) & (inner >= a[2:]) & (inner > 0) & (inner >= PEAK_ABOVE * inner.max(initial=0.0))
    largest = sorted(np.flatnonzero(found), key=lambda i: -inner[i])[:MOST_PEAKS]
    return [int(order[i]) for i in sorted(largest)]


def band_around(frequency_hz: float, width_hz: float) -> tuple[float, float]:
    """Low and high, Hz, of a band `width_hz` wide with a frequency in its middle; never below 0."""
    return max(0.0, frequency_hz - width_hz / 2), frequency_hz + width_hz / 2


def whole_band(freqs_hz: Sequence[float], fps: float) -> tuple[float, float]:
    """0 to half the frame rate, or to the highest frequency where that is above, Hz."""
    return 0.0, max([fps / 2, *freqs_hz])
