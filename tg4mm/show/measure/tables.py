"""A measurement as tables, one value of one axis a row, units in the heads: CSV files, or the sheets of one XLSX."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.files import write_atomic
from tg4mm.show.measure.measurement import Measurement
from tg4mm.show.measure.units import unit_of

MOST_ROWS = 1_048_575  # of a sheet, beside its head


@dataclass(frozen=True)
class Table:
    """Values are texts, or numbers of at most six digits."""

    name: str
    head: Sequence[str]
    rows: Iterable[Sequence[Any]]


def tables_of(found: Measurement) -> list[Table]:
    """series, spectra and peaks."""
    u = unit_of(found).column
    v, a = f"{u}_per_s", f"{u}_per_s2"
    series = [
        "sensor", "clock", "time_s", "axis", f"displacement_{u}", f"deviation_{u}", f"velocity_{v}",
        f"acceleration_{a}", f"velocity_deviation_{v}", f"acceleration_deviation_{a}",
    ]  # fmt: skip
    spectra = ["sensor", "axis", "frequency_hz", f"amplitude_{u}", f"floor_{u}"]
    peaks = [
        "sensor", "axis", "frequency_hz", "frequency_deviation_hz", f"amplitude_{u}", f"deviation_{u}", "phase_rad",
        f"floor_{u}", "is_above", "damping_ratio", "harmonic_of_hz", "sideband_of_hz", "damping_deviation",
        "phase_deviation_rad",
    ]  # fmt: skip
    return [
        Table("series", series, _series_rows(found)),
        Table("spectra", spectra, _spectrum_rows(found)),
        Table("peaks", peaks, _peak_rows(found)),
    ]


def write_csv_files(found: Measurement, out: Path) -> list[Path]:
    """OUT/series.csv, spectra.csv and peaks.csv."""
    paths = []
    for table in tables_of(found):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(chain([table.head], table.rows))
        paths.append(out / f"{table.name}.csv")
        write_atomic(paths[-1], partial(Path.write_text, data=text.getvalue(), encoding="utf-8"))
    return paths


def write_xlsx(found: Measurement, path: Path, settings: Iterable[Sequence[Any]]) -> None:
    """The same tables as sheets, and `settings`, rows of name, value and unit; numbers are cells of numbers."""
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    names = {"spectra": "spectrum", "peaks": "lines"}
    tables = [*tables_of(found), Table("settings", ("name", "value", "unit"), settings)]
    for table in tables:
        rows, part = iter(table.rows), 1
        while True:
            block = list(islice(rows, MOST_ROWS))
            if part > 1 and not block:
                break
            name = names.get(table.name, table.name)
            sheet = book.create_sheet(name if part == 1 else f"{name} {part}")
            sheet.freeze_panes = "A2"
            sheet.append(list(table.head))
            for row in block:
                sheet.append([_cell(v, head in _TEXTS) for head, v in zip(table.head, row, strict=True)])
            part += 1
    write_atomic(path, book.save)


_TEXTS = {"sensor", "clock", "axis", "name", "unit"}  # columns: a sensor may be called 1e3


def _cell(value: Any, is_text: bool = False) -> Any:
    """A number where a text is one; what is not finite is left empty; a text that begins as a formula is text."""
    if isinstance(value, str):
        try:
            value = value if is_text else float(value)
        except ValueError:
            is_text = True
        if is_text:
            return f"'{value}" if value[:1] in ("=", "+", "-", "@") else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _series_rows(found: Measurement) -> Iterable[Sequence[Any]]:
    for result in found.sensors:
        factor = unit_of(found, result).factor
        for record in result.records:
            series, own, sure = record.series, record.derivatives, record.derivative_deviations
            columns = series.displacement, series.deviation, own.velocity, own.acceleration
            values = np.stack([*columns, sure.velocity, sure.acceleration], -1)
            for t, time in enumerate(series.times_s):
                for k, label in enumerate(series.labels):
                    yield (
                        result.name,
                        series.clock,
                        f"{time:.6f}",
                        label,
                        *(_number(v, factor) for v in values[t, k]),
                    )


def _spectrum_rows(found: Measurement) -> Iterable[Sequence[Any]]:
    for result in found.sensors:
        factor, spectrum = unit_of(found, result).factor, result.spectrum
        for f, hz in enumerate(spectrum.freqs_hz):
            for k, label in enumerate(result.labels):
                values = spectrum.amplitude[f, k], spectrum.floor[f, k]
                yield result.name, label, f"{hz:.6g}", *(_number(v, factor) for v in values)


def _peak_rows(found: Measurement) -> Iterable[Sequence[Any]]:
    for result in found.sensors:
        factor = unit_of(found, result).factor
        for peak, damping in zip(result.spectrum.peaks, result.damping, strict=True):
            hz = f"{peak.frequency_hz:.6g}", f"{peak.frequency_deviation_hz:.3g}"
            for k, label in enumerate(result.labels):
                values = _number(peak.amplitude[k], factor), _number(peak.deviation[k], factor)
                phase, floor = f"{np.angle(peak.phasor[k]):.6g}", _number(peak.floor[k], factor)
                zeta = ("", "") if damping is None else (f"{damping.ratio:.4g}", f"{damping.deviation:.3g}")
                of_hz = ["" if o is None else f"{o.of_hz:.6g}" for o in (peak.harmonic, peak.sideband)]
                above, error = int(peak.is_above[k]), f"{peak.phase_deviation[k]:.3g}"
                yield (
                    result.name, label, *hz, *values, phase, floor, above, zeta[0], *of_hz, zeta[1], error,
                )  # fmt: skip


def _number(value: float, factor: float) -> str:
    """Six digits; inf where nothing is observed."""
    return f"{value * factor:.6g}"
