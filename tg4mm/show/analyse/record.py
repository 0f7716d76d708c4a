"""What an analysis is computed of: the channels of a record, and the instrument beside it."""

from functools import cached_property
from pathlib import Path

import numpy as np

from tg4mm.show.analyse.channel import ORDER, AnalyseError, Channel, read_channels
from tg4mm.show.analyse.compare import Change, compared, lines_of
from tg4mm.show.analyse.orders import Speed, speed_of
from tg4mm.show.analyse.quantities import Value
from tg4mm.show.analyse.spectra import averaging_of
from tg4mm.show.analyse.transfer import Transfer, lag_of, transfer_of
from tg4mm.show.options import AnalyseOptions


class Record:
    """A record with the options of its analysis. Raises AnalyseError if files or options are of no use."""

    def __init__(self, path: Path, options: AnalyseOptions) -> None:
        self.path, self.options, self.averaging = path, options, averaging_of(options)
        self.channels = read_channels(path, options.channels)
        self.others = [] if options.reference is None else read_channels(options.reference)
        self.reference = None if options.reference is None else self._chosen()
        if options.sync is not None and options.sync not in [c.name for c in self.others]:
            raise AnalyseError(
                f"--sync {options.sync!r} is no column of {options.reference}; there are: {_names(self.others)}"
            )
        self.before = None if options.against is None else lines_of(options.against)
        if options.modes and not self.moving:
            raise AnalyseError(
                f"{path} holds no displacement, velocity or acceleration, whose modes could be found"
            )

    @property
    def moving(self) -> list[Channel]:
        """The channels of displacement, velocity or acceleration."""
        return [c for c in self.channels if c.quantity in ORDER]

    def quantities(self, channel: Channel) -> list[str]:
        """Names of the quantities that a channel is converted to: derivatives, and integrals where a band is given."""
        order = ORDER.get(channel.quantity)
        if order is None:
            return [channel.quantity]
        return [name for name in ORDER if ORDER[name] >= order or self.options.band is not None]

    @cached_property
    def changes(self) -> tuple[list[Change], list[str]]:
        """Changes against an earlier record, and sentences about lines that one of the two has; empty without one."""
        return ([], []) if self.before is None else compared(self.before, lines_of(self.path))

    @property
    def clock(self) -> Channel | None:
        """The channel of the instrument by which its lag is estimated."""
        return next((c for c in self.others if c.name == self.options.sync), self.reference)

    @cached_property
    def lag(self) -> Value:
        """Seconds that the film's clock is ahead of the instrument's."""
        if self.options.lag is not None:
            return Value(self.options.lag, 0.0)
        assert self.clock is not None
        return lag_of(self.moving[0], self.clock)

    @cached_property
    def transfers(self) -> list[Transfer]:
        """Transfer functions from the reference to every moving channel; none without a reference."""
        if self.reference is None:
            return []
        return [transfer_of(channel, self.reference, self.averaging, self.lag) for channel in self.moving]

    @cached_property
    def speed(self) -> Speed | None:
        """The machine's speed, at the first channel's times; None where no orders are asked for."""
        o = self.options
        return None if o.speed is None and o.tacho is None else speed_of(self.channels[0], o.speed, o.tacho)

    def speed_at(self, channel: Channel) -> Speed:
        """The speed at another channel's times."""
        own, speed = self.channels[0].times_s, self.speed
        assert speed is not None
        if len(own) == len(channel.times_s) and np.allclose(own, channel.times_s):
            return speed
        angle, turns = (np.interp(channel.times_s, own, values) for values in (speed.angle, speed.turns_hz))
        return Speed(speed.source, angle, turns)

    def _chosen(self) -> Channel:
        names, o = _names(self.others), self.options
        if o.column is None:
            if len(self.others) > 1:
                raise AnalyseError(f"{o.reference} has several columns, --input names one of them: {names}")
            return self.others[0]
        for channel in self.others:
            if channel.name == o.column:
                return channel
        raise AnalyseError(f"--input {o.column!r} is no column of {o.reference}; there are: {names}")


def _names(channels: list[Channel]) -> str:
    return ", ".join(c.name for c in channels)
