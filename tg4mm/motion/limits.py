"""What a capture cannot tell of the frequencies found in it, a line each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tg4mm.motion.modes import ModalMotion
from tg4mm.motion.observations import Observations

_MAINS_HZ = (100.0, 120.0)  # light flickers at twice the mains' 50 or 60 Hz
_NEAR_NYQUIST = 0.8
_PEAK = 0.03  # of the strongest mode's rms: what counts as a peak
_ABOVE_FLOOR = 6.0  # times the median mode's rms, where there are modes enough for most of them to be noise
_ENOUGH_MODES = 12
_APART = 1 + 1e-6  # neighbouring bins, whose distance is rounded, are not apart


def peaks(motion: ModalMotion, lowest_hz: float) -> np.ndarray:
    """[K] Hz by falling strength: modes with two periods in the record, no weaker than 3 % of the strongest.

    Of many modes most are noise: then a peak is six times the median one too. A frequency counts once, by its strongest
    mode: what lies within half the lowest frequency of a stronger mode is its flank, or that of a drift.
    """
    rms = np.sqrt((np.abs(motion.displacement) ** 2).sum(2).mean(1)) if len(motion.freqs_hz) else np.zeros(0)
    able = rms[motion.freqs_hz >= lowest_hz]  # a drift is none
    least = _PEAK * able.max(initial=0)
    if len(able) >= _ENOUGH_MODES:
        least = max(least, _ABOVE_FLOOR * float(np.median(able)))
    strongest_first = np.argsort(rms)[::-1]
    hz = np.asarray(motion.freqs_hz, np.float64)[strongest_first]
    apart = _APART * lowest_hz / 2
    is_top = np.array([(np.abs(hz[:i] - f) > apart).all() for i, f in enumerate(hz)], bool)
    return hz[is_top & (rms[strongest_first] >= least) & (hz >= lowest_hz)]


def frequency_notes(hz: Sequence[float] | np.ndarray, observations: Observations) -> list[str]:
    """Frequencies at which flickering light or a faster vibration would look the same."""
    fps, resolution = observations.fps, 1 / observations.duration_s
    out = []
    for f in hz:
        for mains in _MAINS_HZ:
            alias = abs(mains - round(mains / fps) * fps)
            if alias > resolution and abs(f - alias) < resolution / 2:
                out.append(
                    f"{f:.4g} Hz is where light that flickers at {mains:g} Hz appears at {fps:.4g} frames/s: "
                    "switch the light off, or change the frame rate, to tell it from motion"
                )
        if f > _NEAR_NYQUIST * fps / 2:
            out.append(
                f"{f:.4g} Hz is close to half the frame rate: a vibration of {fps - f:.4g} Hz would look the same; "
                "a higher frame rate tells them apart"
            )
    return out
