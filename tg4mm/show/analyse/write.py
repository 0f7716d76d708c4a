"""An analysis: what is asked of a record, computed, and written as JSON, CSV and plots into one folder."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm import __version__
from tg4mm.core.files import to_json, write_atomic, write_json
from tg4mm.core.progress import progress
from tg4mm.core.work_folder import WorkFolder
from tg4mm.show.analyse.channel import ORDER, AnalyseError, Channel, doubts_of, read_channels
from tg4mm.show.analyse.compare import Change, compared, lines_of
from tg4mm.show.analyse.modal import Modes, from_transfers, operational
from tg4mm.show.analyse.orders import OrderTrack, Speed, orders_of, speed_of
from tg4mm.show.analyse.quantities import Levels, Value, levels_of
from tg4mm.show.analyse.spectra import Averaging, Density, density_of
from tg4mm.show.analyse.transfer import Curve, Phase, Transfer, curve_of, lag_of, phases_of, transfer_of
from tg4mm.show.analyse.zones import Zone, zone_of

MARK = "analysis.json"


@dataclass(frozen=True)
class AnalyseOptions:
    """What is asked for beside levels, spectra and phases."""

    channels: Sequence[str] = ()  # (): all
    band: tuple[float, float] | None = None  # Hz, of levels and modes
    averaging: Averaging = field(default_factory=Averaging)
    machine: str | None = None  # class I to IV
    reference: Path | None = None  # a CSV file of a second instrument
    column: str | None = None  # of it; None: the only one
    # column of it, of an accelerometer where the first channel is, that tells the lag
    sync: str | None = None
    lag: float | None = None  # seconds; None: estimated
    against: Path | None = None  # an earlier record
    modes: bool = False
    speed: str | None = None  # revolutions per minute, or "auto": orders of it
    tacho: Path | None = None  # a CSV file of a tachometer, in its place
    orders: Sequence[float] = ()  # (): 1 to 6


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
    channels = read_channels(path, o.channels)
    others = [] if o.reference is None else read_channels(o.reference)
    reference = None if o.reference is None else _chosen(others, o)
    if o.sync is not None and o.sync not in [c.name for c in others]:
        raise AnalyseError(f"--sync {o.sync!r} is no column of {o.reference}; there are: {_names(others)}")
    before = None if o.against is None else lines_of(o.against)
    zones = [] if o.machine is None else [zone_of(c, o.machine) for c in channels if c.quantity in ORDER]
    densities = [density_of(c, o.averaging) for c in channels]
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
        transfers = [transfer_of(channel, reference, o.averaging, lag) for channel in moving]
        instrument = clock if clock.quantity in ORDER else None
        curves = [] if instrument is None else [curve_of(moving[0], instrument, lag, o.band)]
    modes = [operational(moving, o.band)] if o.modes else []
    modes += [from_transfers(transfers, o.band)] if o.modes and transfers else []
    orders: list[OrderTrack] = []
    if o.speed is not None or o.tacho is not None:
        speed = speed_of(channels[0], o.speed, o.tacho)
        orders = [
            track
            for c in moving
            for track in orders_of(c, _for(speed, channels[0], c), o.orders, o.averaging)
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


def work_folder(out: Path) -> WorkFolder:
    """OUT as the folder of an analysis."""
    return WorkFolder(out, MARK, AnalyseError)


def write_analysis(found: Analysis, out: Path, averaging: Averaging) -> None:
    """OUT/analysis.json with everything; levels, psd, transfer and stabilisation as CSV; plots."""
    from tg4mm.show.analyse.plots import write_plots

    own = {f.name: _plain(getattr(found, f.name)) for f in fields(found) if f.name != "channels"}
    own["psd"] = [
        {"channel": c.name, "unit": f"({c.unit})²/Hz", **d}
        for c, d in zip(found.channels, own.pop("densities"), strict=True)
    ]
    content = {
        "format": "tg4mm", "kind": "analysis", "version": 1, "program": f"tg4mm {__version__}",
        "averaging": _plain(averaging), "deviations": "one standard deviation; null: none is stated", **own,
    }  # fmt: skip
    write_json(out / MARK, to_json(content, MARK))
    heads = {
        "levels.csv": ("channel", "quantity", "unit", "low_hz", "high_hz", "figure", "value", "deviation"),
        "psd.csv": ("channel", "unit", "frequency_hz", "density", "low", "high", "noise"),
        "transfer.csv": (
            "response", "input", "unit", "frequency_hz", "h1", "h1_deviation", "h1_phase_rad", "phase_deviation_rad",
            "h2", "h2_phase_rad", "coherence",
        ),
        "orders.csv": (
            "channel", "unit", "order", "time_s", "speed_rpm", "amplitude", "deviation",
        ),
        "reference.csv": ("channel", "instrument", "unit", "time_s", "value", "deviation", "instrument_value"),
        "stabilisation.csv": ("method", "order", "frequency_hz", "stable"),
    }  # fmt: skip
    for name, rows in (
        ("levels.csv", _level_rows(found)), ("psd.csv", _psd_rows(found)), ("transfer.csv", _transfer_rows(found)),
        ("orders.csv", _order_rows(found)), ("reference.csv", _curve_rows(found)),
        ("stabilisation.csv", ((m.method, *map(_text, row)) for m in found.modes for row in m.diagram)),
    ):  # fmt: skip
        _write_csv(out / name, heads[name], rows)
    write_plots(found, out, averaging)


def _plain(value: Any) -> Any:
    """Dictionaries, lists and numbers; complex numbers as size and phase; null for what is not finite."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return {"size": _plain(np.abs(value)), "phase_rad": _plain(np.angle(value))}
        return [_plain(v) for v in value.tolist()]
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value


def _text(value: Any) -> str:
    return f"{value:.6g}" if np.isfinite(value) else ""


def _level_rows(found: Analysis) -> Iterable[Sequence[Any]]:
    for level in found.levels:
        head = level.channel, level.quantity, level.unit, *map(_text, level.band_hz)
        for name in ("peak", "peak_to_peak", "rms", "crest", "db", "rms_g"):
            if (own := getattr(level, name)) is not None:
                yield *head, name, _text(own.value), _text(own.deviation)


def _psd_rows(found: Analysis) -> Iterable[Sequence[Any]]:
    for channel, own in zip(found.channels, found.densities, strict=True):
        for values in zip(own.freqs_hz, own.density, own.low, own.high, strict=True):
            yield channel.name, f"({channel.unit})²/Hz", *map(_text, values), _text(own.noise)


def _transfer_rows(found: Analysis) -> Iterable[Sequence[Any]]:
    for t in found.transfers:
        columns = (
            t.freqs_hz, abs(t.h1), t.deviation, np.angle(t.h1), t.phase_deviation, abs(t.h2), np.angle(t.h2),
            t.coherence,
        )  # fmt: skip
        for values in zip(*columns, strict=True):
            yield t.response, t.reference, t.unit, *map(_text, values)


def _order_rows(found: Analysis) -> Iterable[Sequence[Any]]:
    for o in found.orders:
        for values in zip(o.times_s, o.speed_rpm, o.amplitudes, o.deviations, strict=True):
            yield o.channel, o.unit, _text(o.order), *map(_text, values)


def _curve_rows(found: Analysis) -> Iterable[Sequence[Any]]:
    for c in found.curves:
        for t, value, other in zip(c.times_s, c.values, c.instrument, strict=True):
            yield c.channel, c.reference, c.unit, f"{t:.9g}", _text(value), _text(c.deviation), _text(other)


def _write_csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text, rows = io.StringIO(), list(rows)
    if not rows:
        path.unlink(missing_ok=True)  # of an earlier analysis
        return
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    write_atomic(path, partial(Path.write_text, data=text.getvalue(), encoding="utf-8"))
