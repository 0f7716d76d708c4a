"""The table of engineering quantities: the computation, printed table, CSV file and plots of each.

A new quantity is one entry of QUANTITIES: analysis.json, the printed tables, CSV files and plots all come from it.
`write_analysis` writes them into one folder.
"""

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core import __version__
from tg4mm.core.digits import aligned, value_with_deviation
from tg4mm.core.files import to_json, write_atomic, write_json
from tg4mm.core.pages.charts import pyplot, save
from tg4mm.core.progress import progress
from tg4mm.core.work_folder import WorkFolder
from tg4mm.show.analyse import plots
from tg4mm.show.analyse.channel import ORDER, AnalyseError, doubts_of
from tg4mm.show.analyse.modal import Modes, from_transfers, operational
from tg4mm.show.analyse.orders import OrderTrack, orders_of
from tg4mm.show.analyse.quantities import (
    Levels,
    ThirdOctave,
    Value,
    levels_of,
    third_octaves_of,
    zone_of,
)
from tg4mm.show.analyse.record import AnalysedRecord, Change
from tg4mm.show.analyse.transfer import Curve, Transfer, curve_of, density_of, phases_of
from tg4mm.show.options import AnalyseOptions

Rows = Iterable[Sequence[Any]]
MARK = "analysis.json"


def _nothing(_: Any) -> Rows:
    return ()


@dataclass(frozen=True)
class Quantity:
    """An engineering quantity; tables without rows are left out."""

    name: str  # of its results in analysis.json
    compute: Callable[[AnalysedRecord], Iterable[Any]]
    printed: tuple[str, ...] = ()  # head of the printed table
    lines: Callable[[Any], Rows] = _nothing  # of the printed table, texts of one result
    file: str = ""  # CSV file
    columns: tuple[str, ...] = ()
    rows: Callable[[Any], Rows] = _nothing  # of the CSV file, texts and numbers of one result
    plot: Callable[[Any, AnalysedRecord, Sequence[Any]], Iterator[tuple[str, Any]]] | None = (
        None  # names and figures
    )


def _levels(record: AnalysedRecord) -> Iterator[Levels]:
    for channel in record.channels:
        for quantity in record.quantities(channel):
            yield levels_of(channel, quantity, record.options.band)


def _level_lines(v: Levels) -> Rows:
    db = "" if np.isnan(v.db.value) else f"{_both(v.db)} dB re {v.db_reference}".removesuffix(" 1")
    yield (
        v.channel, v.quantity, _both(v.peak), _both(v.peak_to_peak), f"{_both(v.rms)} {v.unit}".removesuffix(" 1"),
        _both(v.crest), _range(v.band_hz), f"{_both(v.rms_g)} g rms" if v.rms_g is not None else db,
    )  # fmt: skip


def _level_rows(v: Levels) -> Rows:
    for name in ("peak", "peak_to_peak", "rms", "crest", "db", "rms_g"):
        if (own := getattr(v, name)) is not None:
            yield v.channel, v.quantity, v.unit, *v.band_hz, name, own.value, own.deviation


def _third_octaves(record: AnalysedRecord) -> Iterator[ThirdOctave]:
    for channel in record.channels:
        for quantity in record.quantities(channel):
            yield from third_octaves_of(channel, quantity)


def _transfer_lines(t: Transfer) -> Rows:
    k = int(np.abs(t.h1).argmax())
    largest = _both(Value(float(abs(t.h1[k])), float(t.deviation[k])))
    yield (
        t.response, t.reference, _both(t.lag_s), str(t.averages), f"{largest} {t.unit}", f"{t.freqs_hz[k]:.4g}",
        f"{t.coherence[k]:.3f}",
    )  # fmt: skip


def _transfer_rows(t: Transfer) -> Rows:
    columns = (
        t.freqs_hz, abs(t.h1), t.deviation, np.angle(t.h1), t.phase_deviation, abs(t.h2), np.angle(t.h2), t.coherence,
    )  # fmt: skip
    for values in zip(*columns, strict=True):
        yield t.response, t.reference, t.unit, *values


def _curves(record: AnalysedRecord) -> list[Curve]:
    clock = record.clock
    if clock is None or clock.quantity not in ORDER or not record.moving:
        return []
    return [curve_of(record.moving[0], clock, record.lag, record.options.band)]


def _curve_lines(c: Curve) -> Rows:
    difference = f"{c.difference_rms:.3g} {c.unit}"
    yield c.channel, c.reference, _range(c.band_hz), _both(c.ratio), difference, f"{c.correlation:.4f}"


def _curve_rows(c: Curve) -> Rows:
    for t, value, other in zip(c.times_s, c.values, c.instrument, strict=True):
        yield c.channel, c.reference, c.unit, f"{t:.9g}", value, c.deviation, other


def _modes(record: AnalysedRecord) -> Iterator[Modes]:
    if record.options.modes:
        yield operational(record.moving, record.options.band)
        if record.transfers:
            yield from_transfers(record.transfers, record.options.band)


def _mode_lines(m: Modes) -> Rows:
    for mode in m.modes:
        percent = Value(100 * mode.damping.value, 100 * mode.damping.deviation)
        mac = "" if mode.mac is None else f"{mode.mac:.3f}"
        yield m.method, _both(mode.frequency_hz), _both(percent), mac


def _orders(record: AnalysedRecord) -> Iterator[OrderTrack]:
    if record.speed is not None:
        for c in record.moving:
            yield from orders_of(c, record.speed_at(c), record.options.orders, record.averaging)


def _order_lines(o: OrderTrack) -> Rows:
    largest = "–", "–"
    if np.isfinite(o.amplitudes).any():
        k = int(np.nanargmax(o.amplitudes))
        value = Value(float(o.amplitudes[k]), float(o.deviations[k]))
        largest = f"{_both(value)} {o.unit}", f"{o.speed_rpm[k]:.5g}"
    low, high = f"{o.speed_rpm.min():.5g}", f"{o.speed_rpm.max():.5g}"
    speed = low if low == high else f"{low} to {high}"
    yield o.channel, f"{o.order:g}", speed, f"{_both(o.amplitude)} {o.unit}", _degrees(o.phase), *largest


def _order_rows(o: OrderTrack) -> Rows:
    for values in zip(o.times_s, o.speed_rpm, o.amplitudes, o.deviations, strict=True):
        yield o.channel, o.unit, o.order, *values


def _change_lines(c: Change) -> Rows:
    after = f"{_both(c.after)} {c.unit if c.unit != '1' else ''}".rstrip()
    yield c.where, c.figure, _both(c.before), after, f"{c.score:+.1f}", "changed" if c.changed else ""


def _range(values: Sequence[float]) -> str:
    return f"{values[0]:.3g} to {values[1]:.4g}"


def _degrees(phase: Value) -> str:
    return f"{np.degrees(phase.value):+.1f} ± {np.degrees(phase.deviation):.1f}"


def _both(value: Value) -> str:
    if np.isnan(value.value):
        return "–"
    if not np.isfinite(value.deviation):
        return f"{value.value:.4g}"
    return value_with_deviation(value.value, value.deviation)


QUANTITIES = (
    Quantity(
        "levels", _levels,
        ("channel", "", "peak", "peak to peak", "rms", "crest factor", "Hz", ""), _level_lines,
        "levels.csv", ("channel", "quantity", "unit", "low_hz", "high_hz", "figure", "value", "deviation"), _level_rows,
    ),
    Quantity(
        "zones", lambda r: [zone_of(c, r.options.machine) for c in r.moving] if r.options.machine else [],
        ("channel", "velocity, mm/s rms", "class", "zone (ISO 20816-1)"),
        lambda z: [(z.channel, _both(z.rms), z.machine, z.zone)],
    ),
    Quantity(
        "third_octaves", _third_octaves,
        file="third_octaves.csv",
        columns=("channel", "quantity", "unit", "midband_hz", "low_hz", "high_hz", "rms", "deviation"),
        rows=lambda b: [
            (b.channel, b.quantity, b.unit, b.midband_hz, *b.band_hz, b.rms.value, b.rms.deviation)
        ],
        plot=plots.third_octaves,
    ),
    Quantity(
        "phases", lambda record: phases_of(record.channels, record.channels[0]),
        ("channel", "against", "Hz", "ratio", "phase, deg"),
        lambda p: [(p.channel, p.reference, _both(p.frequency_hz), _both(p.ratio), _degrees(p.phase))],
    ),
    Quantity(
        "transfers", lambda record: record.transfers,
        ("response", "input", "lag, s", "averages", "largest |H1|", "at, Hz", "coherence there"), _transfer_lines,
        "transfer.csv",
        (
            "response", "input", "unit", "frequency_hz", "h1", "h1_deviation", "h1_phase_rad", "phase_deviation_rad",
            "h2", "h2_phase_rad", "coherence",
        ),
        _transfer_rows, plots.transfers,
    ),
    Quantity(
        "curves", _curves,
        ("channel", "instrument", "Hz", "channel / instrument", "difference, rms", "correlation"), _curve_lines,
        "reference.csv", ("channel", "instrument", "unit", "time_s", "value", "deviation", "instrument_value"),
        _curve_rows, plots.curves,
    ),
    Quantity(
        "modes", _modes,
        ("modes by", "frequency, Hz", "damping, %", "MAC with FDD"), _mode_lines,
        "stabilisation.csv", ("method", "order", "frequency_hz", "stable"),
        lambda m: ((m.method, *row) for row in m.diagram), plots.stabilisation,
    ),
    Quantity(
        "orders", _orders,
        ("channel", "order", "rpm", "amplitude", "phase, deg", "largest in a segment", "at rpm"), _order_lines,
        "orders.csv", ("channel", "unit", "order", "time_s", "speed_rpm", "amplitude", "deviation"),
        _order_rows, plots.orders,
    ),
    Quantity(
        "changes", lambda record: record.changes[0],
        ("changed", "", "before", "after", "difference / ±", ""), _change_lines,
    ),
    Quantity(
        "psd", lambda record: [density_of(c, record.averaging) for c in record.channels],
        file="psd.csv", columns=("channel", "unit", "frequency_hz", "density", "low", "high", "noise"),
        rows=lambda d: (
            (d.channel, d.unit, *values, d.noise)
            for values in zip(d.freqs_hz, d.density, d.low, d.high, strict=True)
        ),
        plot=plots.spectra,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Analysis:
    """The results of a record, by the names in `QUANTITIES`."""

    record: AnalysedRecord
    results: dict[str, tuple[Any, ...]]
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> tuple[Any, ...]:
        return self.results[name]


def analyse(path: Path, options: AnalyseOptions | None = None) -> Analysis:
    """Compute all quantities of a folder of `tg4mm measure`, a CSV file or a universal file. Raises AnalyseError."""
    record, results = AnalysedRecord(path, options or AnalyseOptions()), {}
    with progress("analysis", len(QUANTITIES), "quantities", brief=True) as update:
        for done, quantity in enumerate(QUANTITIES, 1):
            results[quantity.name] = tuple(quantity.compute(record))
            update(done)
    zones = (note for zone in results["zones"] for note in zone.notes)
    notes = [*record.changes[1], *zones, *doubts_of(path)]
    return Analysis(record, results, tuple(dict.fromkeys(notes)))


def work_folder(out: Path) -> WorkFolder:
    """Return OUT as the folder of an analysis."""
    return WorkFolder(out, MARK, AnalyseError)


def format_analysis(found: Analysis) -> str:
    """Return the printed tables of the quantities that have results, and the notes."""
    parts = []
    for quantity in QUANTITIES:
        if lines := [line for result in found[quantity.name] for line in quantity.lines(result)]:
            parts.append("".join(f"{line}\n" for line in aligned([quantity.printed, *lines])))
    parts.append("".join(f"note: {note}\n" for note in found.notes))
    return "\n".join(part for part in parts if part)


def write_analysis(found: Analysis, out: Path, plots: bool = True) -> None:
    """Write OUT/analysis.json with everything, a CSV file for each quantity that has rows, and plots if wanted."""
    content = {
        "format": "tg4mm", "kind": "analysis", "version": 1, "program": f"tg4mm {__version__}",
        "averaging": _plain(found.record.averaging), "deviations": "one standard deviation; null: none is stated",
        **_plain(found.results), "notes": list(found.notes),
    }  # fmt: skip
    write_json(out / MARK, to_json(content, MARK))
    for quantity in QUANTITIES:
        if quantity.file:
            rows = [row for result in found[quantity.name] for row in quantity.rows(result)]
            _write_csv(out / quantity.file, quantity.columns, rows)
    if plots:
        _write_plots(found, out / "plots")


def _plain(value: Any) -> Any:
    """Return dictionaries, lists and numbers; complex numbers as size and phase; None for what is not finite."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {name: _plain(own) for name, own in value.items()}
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
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if np.isfinite(value) else ""


def _write_csv(path: Path, head: Sequence[str], rows: Sequence[Iterable[Any]]) -> None:
    if not rows:
        path.unlink(missing_ok=True)  # of an earlier analysis
        return

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([head, *(map(_text, row) for row in rows)])

    write_atomic(path, write)


def _write_plots(found: Analysis, folder: Path) -> None:
    """Write FOLDER/*.png and remove those of an earlier analysis."""
    made: set[Path] = set()
    folder.mkdir(parents=True, exist_ok=True)
    with pyplot() as plt:
        for quantity in QUANTITIES:
            if quantity.plot is not None:
                for name, figure in quantity.plot(plt, found.record, found[quantity.name]):
                    made.add(path := folder / (re.sub(r"[^\w.-]+", "_", name) + ".png"))
                    save(plt, figure, [path])
    for old in set(folder.glob("*.png")) - made:
        old.unlink()
