"""Two records of one machine: which line changed its frequency, amplitude or damping, by the difference over its ±."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from tg4mm.core.untrusted import read_json
from tg4mm.show.analyse.channel import AnalyseError, Channel, length_of, read_channels, readable
from tg4mm.show.analyse.quantities import Value

CHANCE = 0.01  # that any of the differences is called a change where nothing changed
_NEAR = 0.1  # of a frequency: lines nearer than that are the same
_LEAST = 3.0  # deviations nearer than which they are


@dataclass(frozen=True)
class Found:
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


def lines_of(path: Path) -> list[Found]:
    """The peaks of a folder of `tg4mm measure` along each sensor's main axis, or the lines of a CSV file's channels."""
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


def _of_peak(sensor: Any, peak: Any, base: str, factor: float) -> Found:
    size = Value(float(peak["main_amplitude"]) * factor, float(peak["main_deviation"] or 0) * factor)
    hz = Value(float(peak["frequency_hz"]), float(peak["frequency_deviation_hz"]))
    ratio, sure = peak["damping_ratio"], peak["damping_deviation"]
    damping = None if ratio is None or sure is None else Value(float(ratio), float(sure))
    return Found(str(sensor["name"]), base, hz, size, damping)


def _of_channel(channel: Channel) -> list[Found]:
    out = []
    for line in channel.lines:
        size = float(line.amplitude[0])
        spread = float(np.hypot(line.amplitude_deviation[0], channel.share * size))
        damping = None if line.damping is None else Value(line.damping, line.damping_deviation or 0.0)
        hz = Value(line.hz, line.hz_deviation)
        out.append(Found(channel.name, channel.unit, hz, Value(size, spread), damping))
    return out


def compared(before: Sequence[Found], after: Sequence[Found]) -> tuple[list[Change], list[str]]:
    """Changes of lines that both have, and sentences about those that one has. Raises AnalyseError for two units."""
    units = {f.unit for f in (*before, *after)}
    if len(units) > 1:
        raise AnalyseError(f"the two records have amplitudes in {' and '.join(sorted(units))}")
    rest, pairs, alone = list(after), [], []
    for a in sorted(before, key=lambda f: -f.amplitude.value):
        near = [b for b in rest if b.where == a.where and _distance(a, b) < 1]
        if not near:
            alone.append(f"{a.where}: {a.frequency.value:.4g} Hz is in the first record only")
            continue
        b = min(near, key=lambda b: _distance(a, b))
        rest.remove(b)
        pairs.append((a, b))
    alone += [f"{b.where}: {b.frequency.value:.4g} Hz is in the second record alone" for b in rest]
    rows = [
        (a.where, name, unit, x, y)
        for a, b in pairs
        for name, unit, x, y in (
            ("frequency", "Hz", a.frequency, b.frequency), ("amplitude", a.unit, a.amplitude, b.amplitude),
            ("damping", "1", a.damping, b.damping),
        )
        if x is not None and y is not None
    ]  # fmt: skip
    least = float(norm.isf(CHANCE / 2 / max(len(rows), 1)))
    out = []
    for where, name, unit, x, y in rows:
        score = (y.value - x.value) / max(float(np.hypot(x.deviation, y.deviation)), 1e-300)
        out.append(Change(where, name, unit, x, y, score, abs(score) > least))
    return out, alone


def _distance(a: Found, b: Found) -> float:
    """Below 1: may be the same line."""
    reach = _NEAR * a.frequency.value, _LEAST * np.hypot(a.frequency.deviation, b.frequency.deviation)
    return abs(a.frequency.value - b.frequency.value) / float(max(reach))
