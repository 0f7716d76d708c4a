"""The input of an analysis: the channels of a record, the instrument beside it, and an earlier record."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from tg4mm.core.untrusted import read_json
from tg4mm.show.analyse.channel import ORDER, AnalyseError, Channel, length_of, read_channels, readable
from tg4mm.show.analyse.orders import Speed, speed_of
from tg4mm.show.analyse.quantities import Value
from tg4mm.show.analyse.transfer import Transfer, averaging_of, lag_of, transfer_of
from tg4mm.show.options import AnalyseOptions

CHANCE = 0.01  # of a false detection among all differences
_NEAR = 0.1  # of a frequency: nearer lines are the same
_LEAST = 3.0  # deviations within which lines are the same


@dataclass(frozen=True)
class DetectedLine:
    """A line of a sensor or channel; `unit` of its amplitude, zero to peak."""

    where: str
    unit: str
    frequency: Value
    amplitude: Value
    damping: Value | None


@dataclass(frozen=True)
class Change:
    """A change in one figure of a line that both records have; `score` is the difference over its deviation."""

    where: str
    figure: str  # frequency, amplitude, damping
    unit: str
    before: Value
    after: Value
    score: float
    changed: bool


def lines_of(path: Path) -> list[DetectedLine]:
    """Return a measurement's peaks along each sensor's main axis, or the lines of a CSV file's channels."""
    if path.is_file():
        return [found for channel in read_channels(path) for found in _of_channel(channel)]
    read_channels(path)  # says what is wrong with it
    with readable(path):
        content = read_json(path / "measure.json")
        return [
            _of_peak(sensor, peak, *length_of(content, sensor))
            for sensor in content["sensors"]
            for peak in sensor["peaks"]
            if peak["main_is_above"]
        ]


def _of_peak(sensor: Any, peak: Any, base: str, factor: float) -> DetectedLine:
    size = Value(float(peak["main_amplitude"]) * factor, float(peak["main_deviation"] or 0) * factor)
    hz = Value(float(peak["frequency_hz"]), float(peak["frequency_deviation_hz"]))
    ratio, sure = peak["damping_ratio"], peak["damping_deviation"]
    damping = None if ratio is None or sure is None else Value(float(ratio), float(sure))
    return DetectedLine(str(sensor["name"]), base, hz, size, damping)


def _of_channel(channel: Channel) -> list[DetectedLine]:
    out = []
    for line in channel.lines:
        size = float(line.amplitude[0])
        spread = float(np.hypot(line.amplitude_deviation[0], channel.share * size))
        damping = None if line.damping is None else Value(line.damping, line.damping_deviation or 0.0)
        hz = Value(line.hz, line.hz_deviation)
        out.append(DetectedLine(channel.name, channel.unit, hz, Value(size, spread), damping))
    return out


def compared(before: Sequence[DetectedLine], after: Sequence[DetectedLine]) -> tuple[list[Change], list[str]]:
    """Return the changes of common lines, and sentences about other lines. Raises AnalyseError for two units."""
    units = {f.unit for f in (*before, *after)}
    if len(units) > 1:
        raise AnalyseError(f"the two records have amplitudes in {' and '.join(sorted(units))}")
    rest, rows, alone = list(after), [], []
    for a in sorted(before, key=lambda f: -f.amplitude.value):
        near = [b for b in rest if b.where == a.where and _distance(a, b) < 1]
        if not near:
            alone.append(f"{a.where}: {a.frequency.value:.4g} Hz is in the first record only")
            continue
        rest.remove(b := min(near, key=lambda b: _distance(a, b)))
        for figure, unit in (("frequency", "Hz"), ("amplitude", a.unit), ("damping", "1")):
            x, y = getattr(a, figure), getattr(b, figure)
            if x is not None and y is not None:
                score = (y.value - x.value) / max(float(np.hypot(x.deviation, y.deviation)), 1e-300)
                rows.append(Change(a.where, figure, unit, x, y, score, False))
    alone += [f"{b.where}: {b.frequency.value:.4g} Hz is in the second record alone" for b in rest]
    least = float(norm.isf(CHANCE / 2 / max(len(rows), 1)))
    return [replace(row, changed=abs(row.score) > least) for row in rows], alone


def _distance(a: DetectedLine, b: DetectedLine) -> float:
    """Return the distance of two lines; below 1 they may be the same."""
    reach = _NEAR * a.frequency.value, _LEAST * np.hypot(a.frequency.deviation, b.frequency.deviation)
    return abs(a.frequency.value - b.frequency.value) / float(max(reach))


class AnalysedRecord:
    """A record with the options of its analysis. Raises AnalyseError for unusable files or options."""

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
                f"{path} holds no displacement, velocity or acceleration: no modes can be found"
            )

    @property
    def moving(self) -> list[Channel]:
        """The channels of displacement, velocity or acceleration."""
        return [c for c in self.channels if c.quantity in ORDER]

    def quantities(self, channel: Channel) -> list[str]:
        """Return the quantities to which a channel is converted: derivatives, and integrals if a band is given."""
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
        """The machine's speed, at the first channel's times; None if no orders are requested."""
        o = self.options
        return None if o.speed is None and o.tacho is None else speed_of(self.channels[0], o.speed, o.tacho)

    def speed_at(self, channel: Channel) -> Speed:
        """Return the speed at another channel's times."""
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
