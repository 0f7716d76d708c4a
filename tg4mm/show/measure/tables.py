"""A measurement as tables: printed, CSV and XLSX; and as HDF5 and MAT arrays and SEP005 dictionaries.

`arrays_of` holds every array by its name; CSV and XLSX tables and SEP005 dictionaries are made from it.
"""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.codec import Loss, before_compression
from tg4mm.core import __version__
from tg4mm.core.digits import aligned, value_with_deviation
from tg4mm.core.files import write_atomic
from tg4mm.core.lines import FEWEST
from tg4mm.show.measure.measurement import Measurement, MeasurementUnit, unit_of
from tg4mm.show.measure.sensor_result import SensorRecord, SensorResult
from tg4mm.show.measure.spectrum import Orbit, Peak, main_is_above

MOST_ROWS = 1_048_575  # of a sheet, below its head
_EVEN = 0.02  # of a step
_QUANTITIES = {
    "displacement": ("", "d"),
    "velocity": ("/s", "v"),
    "acceleration": ("/s²", "a"),
}  # unit, SEP005
_TEXTS = {"sensor", "clock", "axis", "name", "unit"}  # columns: a sensor may be called 1e3
_COMPLETE = 0.9  # of an amplitude: if compression let less through, a remark says so
_NO_NOISE_PX = 1e-5  # of a floor: no sensor is so free of noise
HEAD = "sensor", "frequency, Hz", "amplitude", "in pixels", "direction", "phase, deg", "damping", ""


@dataclass(frozen=True)
class ValueTable:
    """Values are texts, or numbers of at most six digits."""

    name: str
    head: Sequence[str]
    rows: Iterable[Sequence[Any]]


def tables_of(found: Measurement) -> list[ValueTable]:
    """Return the tables series, spectra and peaks."""
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
    arrays = arrays_of(found)
    return [
        ValueTable("series", series, _series_rows(arrays)),
        ValueTable("spectra", spectra, _spectrum_rows(arrays)),
        ValueTable("peaks", peaks, _peak_rows(found, arrays)),
    ]


def write_csv_files(found: Measurement, out: Path) -> None:
    """Write OUT/series.csv, spectra.csv and peaks.csv."""

    def write(path: Path, table: ValueTable) -> None:
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(chain([table.head], table.rows))

    for table in tables_of(found):
        write_atomic(out / f"{table.name}.csv", partial(write, table=table))


def write_xlsx(found: Measurement, path: Path) -> None:
    """Write the same tables as sheets, and `settings_of` as rows of name, value and unit; numbers as numbers."""
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    names = {"spectra": "spectrum", "peaks": "lines"}
    settings = [(name, *value) for name, value in settings_of(found).items()]
    for table in [*tables_of(found), ValueTable("settings", ("name", "value", "unit"), settings)]:
        rows, part, name = iter(table.rows), 1, names.get(table.name, table.name)
        while (block := list(islice(rows, MOST_ROWS))) or part == 1:
            sheet = book.create_sheet(name if part == 1 else f"{name} {part}")
            sheet.freeze_panes = "A2"
            sheet.append(list(table.head))
            for row in block:
                sheet.append([_cell(v, head in _TEXTS) for head, v in zip(table.head, row, strict=True)])
            part += 1
    write_atomic(path, book.save)


def _cell(value: Any, is_text: bool) -> Any:
    """Return a cell: text of a number as number, nothing for what is not finite, and no text as a formula."""
    if isinstance(value, str):
        try:
            value = value if is_text else float(value)
        except ValueError:
            is_text = True
        if is_text:
            return f"'{value}" if value[:1] in ("=", "+", "-", "@") else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _series_rows(sensors: Sequence[dict[str, Any]]) -> Iterable[Sequence[Any]]:
    names = [
        *_with_deviation("displacement"),
        "velocity",
        "acceleration",
        "velocity_deviation",
        "acceleration_deviation",
    ]
    for sensor in sensors:
        for own in sensor["series"]:
            values = np.stack([own[name] for name in names], -1)
            for time, axes in zip(own["time"], values, strict=True):
                for label, row in zip(own["axes"], axes, strict=True):
                    yield sensor["name"], own["clock"], f"{time:.6f}", label, *(f"{v:.6g}" for v in row)


def _spectrum_rows(sensors: Sequence[dict[str, Any]]) -> Iterable[Sequence[Any]]:
    for sensor in sensors:
        own = sensor["spectrum"]
        for hz, sizes, floors in zip(own["frequency"], own["amplitude"], own["floor"], strict=True):
            for label, size, floor in zip(sensor["axes"], sizes, floors, strict=True):
                yield sensor["name"], label, f"{hz:.6g}", f"{size:.6g}", f"{floor:.6g}"


def _peak_rows(found: Measurement, sensors: Sequence[dict[str, Any]]) -> Iterable[Sequence[Any]]:
    for result, sensor in zip(found.sensors, sensors, strict=True):
        own = sensor["lines"]
        for p, peak in enumerate(result.spectrum.peaks):
            hz = f"{peak.frequency_hz:.6g}", f"{peak.frequency_deviation_hz:.3g}"
            ratio, sure = own["damping_ratio"][p], own["damping_ratio_deviation"][p]
            zeta = ("", "") if result.damping[p] is None else (f"{ratio:.4g}", f"{sure:.3g}")
            of_hz = ["" if o is None else f"{o.of_hz:.6g}" for o in (peak.harmonic, peak.sideband)]
            for k, label in enumerate(result.labels):
                size, deviation, phase, floor = (
                    f"{own[name][p, k]:.6g}"
                    for name in ("amplitude", "amplitude_deviation", "phase", "floor")
                )
                above, error = int(peak.is_above[k]), f"{own['phase_deviation'][p, k]:.3g}"
                yield (
                    result.name, label, *hz, size, deviation, phase, floor, above, zeta[0], *of_hz, zeta[1], error,
                )  # fmt: skip


def settings_of(found: Measurement) -> dict[str, tuple[Any, str]]:
    """Return how it was measured: value and unit by name."""
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


def units_of(unit: MeasurementUnit) -> dict[str, str]:
    """Return the unit of every array that has one, by its name; its deviation has the same unit."""
    return {
        "time": "s", **{name: unit.name + per for name, (per, _) in _QUANTITIES.items()}, "amplitude": unit.name,
        "floor": unit.name, "frequency": "Hz", "phase": "rad",
    }  # fmt: skip


def arrays_of(found: Measurement) -> list[dict[str, Any]]:
    """Return a dictionary for each sensor: texts, arrays, dictionaries `spectrum` and `lines`, and a list `series`.

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
            "phase": np.array([np.angle(p.phasor) for p in peaks], float).reshape(shape),
            "phase_deviation": of_peaks("phase_deviation"),
            "floor": of_peaks("floor") * factor,
            "damping_ratio": ratio,
            "damping_ratio_deviation": sure,
        },
    }


def _series(record: SensorRecord, factor: float) -> dict[str, Any]:
    own, values, sure = record.series, record.derivatives, record.derivative_deviations
    motion = (
        (own.displacement, own.deviation),
        (values.velocity, sure.velocity),
        (values.acceleration, sure.acceleration),
    )
    out: dict[str, Any] = {"clock": own.clock, "axes": list(own.labels), "time": own.times_s}
    for name, pair in zip(_QUANTITIES, motion, strict=True):
        out |= {key: array * factor for key, array in zip(_with_deviation(name), pair, strict=True)}
    return out


def _with_deviation(name: str) -> tuple[str, str]:
    return name, f"{name}_deviation"


def write_hdf5(found: Measurement, path: Path) -> None:
    """Write groups /settings and /sensors/1 …, whose attributes are texts; each dataset has the attribute `unit`."""
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
    """Write MATLAB's version 5: cell arrays `settings` and `sensors`; `units`, a struct of texts by an array's name."""
    from scipy.io import savemat

    def cells(values: list[Any]) -> np.ndarray:
        out = np.empty(len(values), object)
        out[:] = values
        return out

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: plain(one) for name, one in value.items()}
        return cells([plain(one) for one in value]) if isinstance(value, list) else value

    content = {
        "settings": np.array([[name, *value] for name, value in settings_of(found).items()], object),
        "units": units_of(unit_of(found)),
        "sensors": plain(arrays_of(found)),
    }

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            savemat(file, content, do_compression=True, oned_as="column", long_field_names=True)

    write_atomic(path, write)


def sep005(found: Measurement) -> list[dict[str, Any]]:
    """Return dictionaries as SEP005 has them, one for each sensor, clock, observed axis and quantity.

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
                    data, deviation = (series[name][:, k] for name in _with_deviation(quantity))
                    out.append(
                        {"name": "/".join(parts), "data": data, "time": series["time"].tolist(), **rate,
                         "unit_str": units[quantity], "quantity": letter, "group": result.name, "deviation": deviation}
                    )  # fmt: skip
    return out


def format_table(measurement: Measurement) -> str:
    """Return the table and notes as text; amplitudes are zero to peak along each orbit's main axis."""
    reference = f"phases relative to {measurement.reference}, at its peaks; amplitudes zero to peak"
    notes = (f"note: {note}" for note in measurement.notes)
    return "\n".join([*aligned(table_of(measurement)), "", reference, *notes, ""])


def table_of(measurement: Measurement) -> list[list[str]]:
    """Return rows of texts, the head first; a column of pixels only where amplitudes are not in pixels."""
    rows = [list(HEAD), *(row for result in measurement.sensors for row in rows_of(measurement, result))]
    if unit_of(measurement).name != "px":
        return rows
    return [[cell for k, cell in enumerate(row) if HEAD[k] != "in pixels"] for row in rows]


def rows_of(measurement: Measurement, result: SensorResult) -> list[list[str]]:
    """Return a row of texts for each peak, in the columns of `HEAD`, or one that says that there is none."""
    unit = unit_of(measurement, result)
    out: list[list[str]] = []
    for k, (peak, orbit) in enumerate(zip(result.spectrum.peaks, result.orbits, strict=True)):
        loss = result.loss_of(k)
        size, error = before_compression(orbit.amplitude, orbit.deviation, loss)
        damping, pixels = result.damping[k], result.pixels(orbit.direction)
        percent = () if damping is None else (100 * damping.ratio, 100 * damping.deviation)
        bound = "" if loss is None or not loss.why else "< " if loss.is_made else "> "
        out.append(
            [
                result.name if not out else "",
                value_with_deviation(peak.frequency_hz, peak.frequency_deviation_hz),
                f"{bound}{value_with_deviation(size * unit.factor, error * unit.factor)} {unit.name}",
                f"{bound}{value_with_deviation(size * pixels, error * pixels)} px",
                direction_text(orbit.direction, result.labels),
                phase_text(measurement, result, peak.frequency_hz),
                f"{value_with_deviation(*percent)} %" if percent else "",
                "; ".join([*remarks(peak, orbit, loss), *_hidden(result, orbit)]),
            ]
        )
    if out:
        return out
    found, limit = "none", ""
    floor = result.spectrum.typical_floor
    level = float(np.min(floor[np.isfinite(floor)], initial=np.inf))
    if len(result.times_s) < FEWEST:
        found, why = "", f"fewer than {FEWEST} frames: no spectrum"
    elif level * result.px_per_unit < _NO_NOISE_PX:
        why = "the pictures hold no noise (compression removed it, or the pictures are rendered): no noise floor"
    else:
        in_pixels = "" if unit.name == "px" else f", {level * result.px_per_unit:.2g} px"
        limit, why = (
            f"under {level * unit.factor:.2g} {unit.name}{in_pixels}",
            "nothing above the noise floor",
        )
    return [[result.name, found, limit, "", "", "", "", why]]


def _hidden(result: SensorResult, orbit: Orbit) -> list[str]:
    """Describe the motion in directions that are not resolved."""
    out = []
    for other in orbit.hidden:
        pixels = result.pixels(other.direction)
        size = value_with_deviation(other.amplitude * pixels, other.deviation * pixels)
        out.append(f"not determined along {direction_text(other.direction, result.labels)}: {size} px")
    return out


def remarks(peak: Peak, orbit: Orbit, loss: Loss | None = None) -> list[str]:
    """Return the reasons to doubt a peak or its amplitude."""
    out = [] if main_is_above(peak, orbit) else ["not above twice its deviation"]
    is_lost = loss is not None and loss.is_lost
    if (line := peak.line) is not None and not is_lost:
        changes = {"begins": f"begins at {line.start_s or 0.0:.3g} s", "decays": "rings down"}
        changes |= {"grows": "grows", "varies": "varies"}
        out += [changes[line.change]] if line.change in changes else []
    if (tone := peak.requested) is not None:
        out.append(f"given band, {tone.band[0]:g} to {tone.band[1]:g} Hz: {tone.periods:.2g} periods")
    if loss is not None and (loss.why or loss.gain < _COMPLETE):
        out.append(
            loss.why or f"corrected: compression let {loss.gain:.2f} ± {loss.deviation:.2f} of it through"
        )
    return [*out, *(str(other) for other in (peak.harmonic, peak.sideband) if other is not None)]


def direction_text(direction: np.ndarray, labels: tuple[str, ...]) -> str:
    """Return a direction such as `+0.97 x  −0.24 z`, without components under a twentieth."""
    signed = zip(direction, labels, strict=True)
    return " ".join(f"{'+' if d > 0 else '−'}{abs(d):.2f} {label}" for d, label in signed if abs(d) >= 0.05)


def phase_text(measurement: Measurement, result: SensorResult, frequency_hz: float) -> str:
    """Return the phase against the reference at a frequency, if that is one of its peaks."""
    if result.name == measurement.reference:
        return "reference"
    if result.relation is None:
        return ""
    resolution = 1 / measurement.prepared.observations.duration_s
    for at in result.relation.phases:
        if abs(at.frequency_hz - frequency_hz) < resolution / 2 and at.is_above:
            return f"{np.degrees(at.phase):+.1f} ± {np.degrees(at.deviation):.1f}"
    return ""
