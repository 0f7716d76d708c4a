"""Peaks that a video codec may have made of a stronger vibration.

A codec does not store all frames alike: every few frames one is predicted forward, the ones between it from both sides,
more coarsely. So what a video keeps of a motion of f Hz changes with that period P, and its series shows f at f_P ± f
too, f_P the multiples of frame rate / P (amplitude modulation). Seen on H.264 of x264, P = 4: 3.4 Hz at 30 Hz made
peaks at 7.5 − 3.4 and 15 − 3.4 Hz, thirty times weaker (docs/measure.md). Where the codec takes most of a small motion
away, what is left of it is up to three times the image. Encoders whose frames have no such period make lines at these
places too.
"""

from collections.abc import Sequence
from dataclasses import replace

from tg4mm.show.measure.harmonics import NEAR, SURE, Sideband, seen_at
from tg4mm.show.measure.spectrum import Peak, size_of

USUAL_PERIOD = 4  # frames, of a video whose kinds of frames show none
WEAKER = 2.5  # times weaker than the vibration that it comes of, at least


def with_sidebands(
    peaks: Sequence[Peak], period: int | None, fps: float, duration_s: float
) -> tuple[Peak, ...]:
    """The peaks; weak ones that may be a stronger one's sideband say so. period: frames, `codec_period`."""
    if period is None:
        return tuple(peaks)
    carriers = [k * fps / period for k in range(1, period // 2 + 1)]
    return tuple(replace(p, sideband=_sideband_of(p, peaks, carriers, fps, duration_s)) for p in peaks)


def _sideband_of(
    peak: Peak, peaks: Sequence[Peak], carriers: Sequence[float], fps: float, duration_s: float
) -> Sideband | None:
    for other in sorted(peaks, key=size_of, reverse=True):
        if size_of(other) < WEAKER * size_of(peak):
            return None
        error = SURE * (peak.frequency_deviation_hz**2 + other.frequency_deviation_hz**2) ** 0.5
        for carrier in carriers:
            for is_sum in (False, True):
                hz = carrier + other.frequency_hz if is_sum else abs(carrier - other.frequency_hz)
                if abs(seen_at(hz, fps) - peak.frequency_hz) < max(NEAR / duration_s, error):
                    return Sideband(carrier, other.frequency_hz, is_sum)
    return None
