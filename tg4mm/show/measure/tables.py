"""A measurement in files of other programs: CSV and XLSX tables, HDF5 and MAT arrays, SEP005 dictionaries."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core import __version__
from tg4mm.core.files import write_atomic
from tg4mm.show.measure.measurement import Measurement, Unit, unit_of
from tg4mm.show.measure.sensor_result import Record, SensorResult

MOST_ROWS = 1_048_575  # of a sheet, beside its head
_EVEN = 0.02  # of a step
_QUANTITIES = {"displacement": ("", "d"), "velocity": ("/s", "v"), "acceleration": ("/s²", "a")}


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


def write_xlsx(found: Measurement, path: Path) -> None:
    """The same tables as sheets, and `settings_of` as rows of name, value and unit; numbers are cells of numbers."""
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    names = {"spectra": "spectrum", "peaks": "lines"}
    settings = [(name, *value) for name, value in settings_of(found).items()]
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


def settings_of(found: Measurement) -> dict[str, tuple[Any, str]]:
    """How it was measured: value and unit by name."""
    scene, first = found.prepared, found.sensors[0]
    return {
        "program": (f"tg4mm {__version__}", ""),
        "run": ("" if scene.folder is None else str(scene.folder), ""),
        "length_unit": (unit_of(found).name, ""),
        "scene_unit": (np.nan if (scale := found.unit_scale_m) is None else scale, "m"),
        "sampling_rate": (1 / float(np.median(np.diff(first.times_s))), "Hz"),
        "duration": (float(np.ptp(first.times_s)), "s"),
        "window": (first.spectrum.window, ""),
        "amplitudes": ("zero to peak", ""),
        "deviations": ("one standard deviation; not finite: not observed", ""),
        "floor": ("passed by noise alone in one record of a hundred", ""),
        "reference": (found.reference, ""),
        **{f"sensor {r.name}": (str(r.sensor).partition("=")[2], "") for r in found.sensors},
        **{f"note {k}": (note, "") for k, note in enumerate(found.notes, 1)},
    }


def units_of(unit: Unit) -> dict[str, str]:
    """Return the unit of every array, by its name; its deviation has the same. What has none is not in it."""
    return {
        "time": "s", **{name: unit.name + per for name, (per, _) in _QUANTITIES.items()}, "amplitude": unit.name,
        "floor": unit.name, "frequency": "Hz", "phase": "rad",
    }  # fmt: skip


def arrays_of(found: Measurement) -> list[dict[str, Any]]:
    """One dictionary a sensor: texts, arrays, and dictionaries `spectrum` and `lines`, and a list `series`.

    Arrays are [T, A], [F, A] or [K, A] along the axes that `axes` names; lengths in the unit of the printed table.
    """
    return [_sensor(result, unit_of(found, result).factor) for result in found.sensors]


def _sensor(result: SensorResult, factor: float) -> dict[str, Any]:
    spectrum, peaks = result.spectrum, result.spectrum.peaks
    shape = len(peaks), len(result.labels)

    def of_peaks(name: str) -> np.ndarray:
        return np.array([getattr(p, name) for p in peaks], float).reshape(shape)

    damping = [(np.nan, np.nan) if d is None else (d.ratio, d.deviation) for d in result.damping]
    ratio, sure = np.array(damping, float).reshape(-1, 2).T
    phases = np.array([np.angle(p.phasor) for p in peaks], float).reshape(shape)
    return {
        "name": result.name,
        "region": str(result.sensor).partition("=")[2],
        "axes": list(result.labels),
        "directions": result.axes,
        "series": [_series(record, factor) for record in result.records],
        "spectrum": {
            "frequency": spectrum.freqs_hz,
            "amplitude": spectrum.amplitude * factor,
            "floor": spectrum.floor * factor,
        },
        "lines": {
            "frequency": np.array([p.frequency_hz for p in peaks], float),
            "frequency_deviation": np.array([p.frequency_deviation_hz for p in peaks], float),
            "amplitude": of_peaks("amplitude") * factor,
            "amplitude_deviation": of_peaks("deviation") * factor,
            "phase": phases,
            "phase_deviation": of_peaks("phase_deviation"),
            "floor": of_peaks("floor") * factor,
            "damping_ratio": ratio,
            "damping_ratio_deviation": sure,
        },
    }


def _series(record: Record, factor: float) -> dict[str, Any]:
    own, values, sure = record.series, record.derivatives, record.derivative_deviations
    return {
        "clock": own.clock,
        "axes": list(own.labels),
        "time": own.times_s,
        "displacement": own.displacement * factor,
        "displacement_deviation": own.deviation * factor,
        "velocity": values.velocity * factor,
        "velocity_deviation": sure.velocity * factor,
        "acceleration": values.acceleration * factor,
        "acceleration_deviation": sure.acceleration * factor,
    }


def write_hdf5(found: Measurement, path: Path) -> None:
    """Groups /settings and /sensors/1 …, whose attributes are texts; each dataset has the attribute `unit`."""
    import h5py

    units = units_of(unit_of(found))

    def fill(group: Any, values: dict[str, Any]) -> None:
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                group[name] = value
                group[name].attrs["unit"] = units.get(name.removesuffix("_deviation"), "1")
            elif isinstance(value, dict):
                fill(group.create_group(name), value)
            elif name == "series":
                for k, one in enumerate(value, 1):
                    fill(group.create_group(f"series/{k}"), one)
            else:
                group.attrs[name] = value

    def write(temporary: Path) -> None:
        with h5py.File(temporary, "w") as file:
            settings = file.create_group("settings")
            for name, (value, unit) in settings_of(found).items():
                settings.attrs[f"{name}, {unit}" if unit else name] = value
            for k, sensor in enumerate(arrays_of(found), 1):
                fill(file.create_group(f"sensors/{k}"), sensor)

    write_atomic(path, write)


def write_mat(found: Measurement, path: Path) -> None:
    """MATLAB's version 5: `settings` and `sensors`, cell arrays; `units`, a struct of texts by an array's name."""
    from scipy.io import savemat

    rows = [[name, value, unit] for name, (value, unit) in settings_of(found).items()]
    content = {
        "settings": np.array(rows, object),
        "units": units_of(unit_of(found)),
        "sensors": _cells([_for_mat(sensor) for sensor in arrays_of(found)]),
    }

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            savemat(file, content, do_compression=True, oned_as="column", long_field_names=True)

    write_atomic(path, write)


def _cells(values: list[Any]) -> np.ndarray:
    out = np.empty(len(values), object)
    out[:] = values
    return out


def _for_mat(values: dict[str, Any]) -> dict[str, Any]:
    out = {}
    for name, value in values.items():
        if isinstance(value, list):
            value = _cells([_for_mat(v) if isinstance(v, dict) else v for v in value])
        out[name] = _for_mat(value) if isinstance(value, dict) else value
    return out


def sep005(found: Measurement) -> list[dict[str, Any]]:
    """Dictionaries as SEP005 has them, one for each sensor, clock, axis that is observed, and quantity.

    Keys: `name` (SENSOR/AXIS/QUANTITY), `data` [T], `time` [T] seconds, `fs` Hz where the times are even, `unit_str`,
    `quantity` (d, v, a), `group` (the sensor), and beside the standard's own `deviation` [T], of the same unit.
    """
    out = []
    for result, sensor in zip(found.sensors, arrays_of(found), strict=True):
        units = units_of(unit_of(found, result))
        for series, record in zip(sensor["series"], result.records, strict=True):
            steps = np.diff(series["time"])
            rate = {"fs": 1 / float(steps.mean())} if np.ptp(steps) < _EVEN * steps.mean() else {}
            for k in np.flatnonzero(record.series.is_observed):
                for quantity, (_, letter) in _QUANTITIES.items():
                    parts = result.name, *filter(None, [series["clock"]]), series["axes"][k], quantity
                    out.append(
                        {
                            "name": "/".join(parts),
                            "data": series[quantity][:, k],
                            "time": series["time"].tolist(),
                            **rate,
                            "unit_str": units[quantity],
                            "quantity": letter,
                            "group": result.name,
                            "deviation": series[f"{quantity}_deviation"][:, k],
                        }
                    )
    return out
