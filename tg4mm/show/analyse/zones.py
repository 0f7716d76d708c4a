"""Zones of ISO 20816-1 by class of machine: velocity rms, 10 to 1000 Hz, on parts that do not rotate.

The limits are those of classes I to IV as public tables give them of ISO 10816-1:1995, annex B, which ISO 20816-1
succeeds; the standard decides, and its part for a kind of machine before it. I small machines to 15 kW;
II medium ones to 75 kW, or 300 kW on a foundation of their own; III large ones on a rigid, IV on a soft foundation.
"""

from dataclasses import dataclass

import numpy as np

from tg4mm.show.analyse.channel import AnalyseError, Channel
from tg4mm.show.analyse.quantities import Value, levels_of

BAND_HZ = 10.0, 1000.0
LIMITS = {  # mm/s rms: A to B, B to C, C to D
    "I": (0.71, 1.8, 4.5), "II": (1.12, 2.8, 7.1), "III": (1.8, 4.5, 11.2), "IV": (2.8, 7.1, 18.0),
}  # fmt: skip
_CYCLES = 10  # of the band's lowest frequency in a record
_SURE = 2.0  # deviations


@dataclass(frozen=True)
class Zone:
    """`zone` is a letter, or two where the deviation, doubled, reaches into the next; `notes`: what is not covered."""

    channel: str
    machine: str
    rms: Value  # mm/s
    zone: str
    notes: tuple[str, ...]


def zone_of(channel: Channel, machine: str) -> Zone:
    """Raises AnalyseError for a class that is none, and for a channel whose unit or rate tells nothing of the band."""
    if machine not in LIMITS:
        raise AnalyseError(f"--machine-class {machine!r} is none; there are: {', '.join(LIMITS)}")
    if channel.base != "mm":
        raise AnalyseError(f"{channel.name} is in {channel.unit}: a zone needs millimetres (docs/scale.md)")
    if channel.rate / 2 <= BAND_HZ[0]:
        raise AnalyseError(
            f"{channel.name}: half its rate, {channel.rate / 2:g} Hz, is below the band of a zone, 10 to 1000 Hz"
        )
    rms, notes = levels_of(channel, "velocity", BAND_HZ).rms, []
    ends = [rms.value + k * _SURE * np.nan_to_num(rms.deviation) for k in (-1, 1)]
    low, high = ("ABCD"[int(np.searchsorted(LIMITS[machine], end))] for end in ends)
    if channel.rate / 2 < BAND_HZ[1]:
        notes.append(
            f"the record ends at {channel.rate / 2:g} Hz of 10 to 1000 Hz: the zone is {low} or worse"
        )
    if channel.duration_s * BAND_HZ[0] < _CYCLES:
        notes.append(f"the record of {channel.duration_s:.2g} s holds fewer than {_CYCLES} periods of 10 Hz")
    if not np.isfinite(rms.deviation):
        notes.append("the record states no noise: the value has no deviation")
    return Zone(channel.name, machine, rms, low if low == high else f"{low} or {high}", tuple(notes))
