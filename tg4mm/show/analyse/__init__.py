"""Engineering quantities of a measurement: levels with ±, averaged spectra, zones, transfers, modes, comparisons.

    channels = read_channels(Path("measured"))                  # of `tg4mm measure`, or a CSV file with times
    levels_of(channels[0], "velocity", (10, 1000)).rms          # Value(value, deviation)
    density_of(channels[0])                                     # Welch, with its confidence interval
    transfer_of(channels[0], read_channels(Path("hammer.csv"))[0])   # H1, H2, coherence, lag ±

docs/engineering.md defines them.
"""

from tg4mm.show.analyse.channel import AnalyseError, Channel, read_channels
from tg4mm.show.analyse.modal import from_transfers, mac, operational
from tg4mm.show.analyse.orders import OrderTrack, orders_of, speed_of
from tg4mm.show.analyse.quantities import Levels, Value, converted, levels_of, zone_of
from tg4mm.show.analyse.record import compared, lines_of
from tg4mm.show.analyse.transfer import (
    Averaging,
    Curve,
    Density,
    Transfer,
    curve_of,
    density_of,
    lag_of,
    phases_of,
    transfer_of,
    waterfall_of,
)

__all__ = [
    "AnalyseError",
    "Averaging",
    "Channel",
    "Curve",
    "Density",
    "Levels",
    "OrderTrack",
    "Transfer",
    "Value",
    "compared",
    "converted",
    "curve_of",
    "density_of",
    "from_transfers",
    "lag_of",
    "levels_of",
    "lines_of",
    "mac",
    "operational",
    "orders_of",
    "phases_of",
    "read_channels",
    "speed_of",
    "transfer_of",
    "waterfall_of",
    "zone_of",
]
