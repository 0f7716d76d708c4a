"""Write an analysis as JSON, CSV and plots into one folder."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core import __version__
from tg4mm.core.files import to_json, write_atomic, write_json
from tg4mm.core.work_folder import WorkFolder
from tg4mm.show.analyse.analysis import Analysis
from tg4mm.show.analyse.channel import AnalyseError
from tg4mm.show.analyse.plots import write_plots
from tg4mm.show.analyse.spectra import Averaging

MARK = "analysis.json"


def work_folder(out: Path) -> WorkFolder:
    """OUT as the folder of an analysis."""
    return WorkFolder(out, MARK, AnalyseError)


def write_analysis(found: Analysis, out: Path, averaging: Averaging) -> None:
    """OUT/analysis.json with everything; levels, psd, transfer and stabilisation as CSV; plots."""
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
