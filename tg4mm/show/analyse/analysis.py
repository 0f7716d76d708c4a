"""An analysis: everything that is computed of a record, by the options of `tg4mm analyse`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.core.progress import progress
from tg4mm.show.analyse.channel import ORDER, AnalyseError, Channel, doubts_of, read_channels
from tg4mm.show.analyse.compare import Change, compared, lines_of
from tg4mm.show.analyse.modal import Modes, from_transfers, operational
from tg4mm.show.analyse.orders import OrderTrack, Speed, orders_of, speed_of
from tg4mm.show.analyse.quantities import Levels, Value, levels_of
from tg4mm.show.analyse.spectra import Density, averaging_of, density_of
from tg4mm.show.analyse.transfer import Curve, Phase, Transfer, curve_of, lag_of, phases_of, transfer_of
from tg4mm.show.analyse.zones import Zone, zone_of
from tg4mm.show.options import AnalyseOptions


@dataclass(frozen=True)
class Analysis:
    """Everything that was computed."""

    channels: tuple[Channel, ...]
    levels: tuple[Levels, ...]
    densities: tuple[Density, ...]
    phases: tuple[Phase, ...]
    zones: tuple[Zone, ...] = ()
    transfers: tuple[Transfer, ...] = ()
    modes: tuple[Modes, ...] = ()
    changes: tuple[Change, ...] = ()
    notes: tuple[str, ...] = ()
    orders: tuple[OrderTrack, ...] = ()
    curves: tuple[Curve, ...] = ()


def analyse(path: Path, options: AnalyseOptions | None = None) -> Analysis:
    """Of a folder of `tg4mm measure`, or a CSV file. Raises AnalyseError for what cannot be computed of it."""
    o = options or AnalyseOptions()
    averaging = averaging_of(o)
    channels = read_channels(path, o.channels)
    others = [] if o.reference is None else read_channels(o.reference)
    reference = None if o.reference is None else _chosen(others, o)
    if o.sync is not None and o.sync not in [c.name for c in others]:
        raise AnalyseError(f"--sync {o.sync!r} is no column of {o.reference}; there are: {_names(others)}")
    before = None if o.against is None else lines_of(o.against)
    zones = [] if o.machine is None else [zone_of(c, o.machine) for c in channels if c.quantity in ORDER]
    densities = [density_of(c, averaging) for c in channels]
    moving = [c for c in channels if c.quantity in ORDER]
    if o.modes and not moving:
        raise AnalyseError(
            f"{path} holds no displacement, velocity or acceleration, whose modes could be found"
        )
    levels, lag = [], None if o.lag is None else Value(o.lag, 0.0)
    with progress("analysis", len(channels), "channels", brief=True) as update:
        for done, channel in enumerate(channels, 1):
            order = ORDER.get(channel.quantity)
            for quantity in [channel.quantity] if order is None else ORDER:
                if order is None or ORDER[quantity] >= order or o.band is not None:
                    levels.append(levels_of(channel, quantity, o.band))
            update(done)
    phases = phases_of(channels, channels[0])
    transfers, curves = [], list[Curve]()
    if reference is not None and moving:
        clock = next((c for c in others if c.name == o.sync), reference)
        lag = lag or lag_of(moving[0], clock)
        transfers = [transfer_of(channel, reference, averaging, lag) for channel in moving]
        instrument = clock if clock.quantity in ORDER else None
        curves = [] if instrument is None else [curve_of(moving[0], instrument, lag, o.band)]
    modes = [operational(moving, o.band)] if o.modes else []
    modes += [from_transfers(transfers, o.band)] if o.modes and transfers else []
    orders: list[OrderTrack] = []
    if o.speed is not None or o.tacho is not None:
        speed = speed_of(channels[0], o.speed, o.tacho)
        orders = [
            track for c in moving for track in orders_of(c, _for(speed, channels[0], c), o.orders, averaging)
        ]
    changes, notes = ([], []) if before is None else compared(before, lines_of(path))
    notes += [*(note for zone in zones for note in zone.notes), *doubts_of(path)]
    return Analysis(
        tuple(channels), tuple(levels), tuple(densities), tuple(phases), tuple(zones), tuple(transfers),
        tuple(modes), tuple(changes), tuple(dict.fromkeys(notes)), tuple(orders), tuple(curves),
    )  # fmt: skip


def _for(speed: Speed, of: Channel, channel: Channel) -> Speed:
    """The speed at another channel's times."""
    if len(of.times_s) == len(channel.times_s) and np.allclose(of.times_s, channel.times_s):
        return speed
    angle, turns = (np.interp(channel.times_s, of.times_s, own) for own in (speed.angle, speed.turns_hz))
    return Speed(speed.source, angle, turns)


def _names(channels: list[Channel]) -> str:
    return ", ".join(c.name for c in channels)


def _chosen(channels: list[Channel], options: AnalyseOptions) -> Channel:
    names = _names(channels)
    if options.column is None:
        if len(channels) > 1:
            raise AnalyseError(f"{options.reference} has several columns, --input names one of them: {names}")
        return channels[0]
    for channel in channels:
        if channel.name == options.column:
            return channel
    raise AnalyseError(f"--input {options.column!r} is no column of {options.reference}; there are: {names}")
