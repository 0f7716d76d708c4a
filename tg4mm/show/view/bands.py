"""Bands: from the slider, around a peak of the spectrum, and as words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tg4mm.core.pages.svg import number
from tg4mm.show.view.colours import Band

ALL = "all"  # the button for all frequencies
_BUTTONS = 8  # peaks that get a button of their own
_FAINT = 0.05  # of the largest peak; what is below is not looked for


def band_of_slider(low: float, high: float, nyquist: float) -> Band:
    """The band between two slider positions, Hz; None, all frequencies, where it is the whole range."""
    low, high = min(low, high), max(low, high)
    return None if low <= 0 and high >= nyquist * (1 - 1e-9) else (low, high)


def band_around(frequency: float, frequencies: np.ndarray, nyquist: float) -> tuple[float, float]:
    """A band around one of `frequencies` (Hz) that holds no other: a tenth of it to either side, or less."""
    others = np.abs(frequencies - frequency)
    others = others[others > 1e-9]
    reach = min(0.1 * frequency, 0.5 * float(others.min()) if len(others) else np.inf)
    return max(frequency - reach, 0.0), min(frequency + reach, nyquist)


def main_peaks(frequencies: np.ndarray, peaks: np.ndarray, duration: float) -> np.ndarray:
    """The frequencies that get a button: those that move most, ascending; none below 5 % of the largest peak.

    What takes longer for a cycle than the capture's `duration` in seconds is drift, unless there is nothing else.
    """
    cyclic = frequencies * duration > 1 - 1e-9
    peaks = np.where(cyclic, peaks, 0.0) if cyclic.any() else peaks
    order = np.argsort(-peaks, kind="stable")[:_BUTTONS]
    return np.sort(frequencies[[k for k in order if peaks[k] >= _FAINT * peaks.max()]])


def peak_labels(frequencies: Sequence[float] | np.ndarray) -> tuple[str, ...]:
    """`3.4 Hz` for each, with as many digits as it takes to tell them apart."""
    for digits in (3, 4, 5, 6):
        labels = tuple(f"{number(float(f), digits)} Hz" for f in frequencies)
        if len(set(labels)) == len(labels):
            return labels
    return tuple(f"{float(f)!r} Hz" for f in frequencies)


def band_words(band: Band, frequencies: np.ndarray) -> str:
    """What the band holds, in one line."""
    if not len(frequencies):
        return "This run has no frequencies to magnify."
    count = len(frequencies)
    if band is None:
        return f"All frequencies ({count})."
    inside = int(((frequencies >= band[0]) & (frequencies <= band[1])).sum())
    between = f"{number(band[0])} to {number(band[1])} Hz"
    if not inside:
        return f"{between}: none of the {count} frequencies; nothing is magnified."
    return f"{between}: {inside} of {count} frequencies."
