"""Universal files for modal analysis programs: geometry (15, 82), shapes (55), waveforms and spectra (58), units (164).

Nodes 1 … S are the sensors; from 1001 on Gaussians, thinned evenly. Directions 1, 2, 3 are the world's x, y, z; what a
single camera does not observe counts as 0, and the identification line says so. Lengths are metres where the scale is
known, else scene units.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pyuff
from scipy.spatial import cKDTree

from tg4mm.core.files import replacing
from tg4mm.show.measure.measurement import Measurement, unit_of
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.series import Series
from tg4mm.show.measure.spectrum import frequency_grid, transformed

MOST_NODES = 1500
FIRST_GAUSSIAN = 1001
_LINE = 240  # entries of a trace line, 250 at most
_NEIGHBOURS = 3
_TIME, _GENERAL = (
    1,
    0,
)  # function types of dataset 58; a spectrum is general, since 12 is written by few programs
_DISPLACEMENT = 8  # specific data type
_WAVEFORM, _SPECTRUM = "displacement", "amplitude spectrum, Hann, zero to peak"
_DEVIATION = "displacement, standard deviation"


def write_uff(measurement: Measurement, path: Path) -> None:
    """Write the file atomically."""
    with replacing(path, ".uff") as temporary:  # pyuff wants the ending
        pyuff.UFF(str(temporary)).write_sets(_sets(measurement), mode="overwrite")


def _sets(measurement: Measurement) -> list[dict[str, Any]]:
    scene, unit = measurement.prepared, unit_of(measurement)
    metres = unit.uff[1]
    rows = _thinned(scene.means, scene.seen)
    bodies = np.stack([r.body.centre for r in measurement.sensors])
    positions = np.concatenate([bodies, scene.means[rows]]) * metres
    numbers = np.concatenate([1 + np.arange(len(bodies)), FIRST_GAUSSIAN + np.arange(len(rows))])
    out = [_units(unit.uff[0], unit.uff[2]), _nodes(numbers, positions), *_lines(scene.means[rows])]
    for k, shape in enumerate(measurement.shapes):
        values = np.where(shape.is_above[:, None], shape.phasors, 0)[rows]
        own = np.stack([_at(r, shape.frequency_hz) for r in measurement.sensors])
        out.append(_shape(k, shape.frequency_hz, numbers, np.concatenate([own, values]) * metres))
    for s, result in enumerate(measurement.sensors):
        out += _functions(s + 1, result, metres, unit.uff[2])
    return out


def _thinned(means: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Indices of Gaussians that are seen, spread evenly: the most seen one of every cell of a grid."""
    rows = np.flatnonzero(seen > 0.5)
    rows = rows if len(rows) else np.arange(len(means))
    if len(rows) <= MOST_NODES:
        return rows
    size = float(np.linalg.norm(np.ptp(np.quantile(means[rows], [0.01, 0.99], axis=0), axis=0))) / 30
    while True:
        cells = np.floor(means[rows] / size).astype(np.int64)
        order = np.argsort(-seen[rows], kind="stable")
        _, first = np.unique(cells[order], axis=0, return_index=True)
        if len(first) <= MOST_NODES:
            return np.sort(rows[order[first]])
        size *= 1.15


def _units(code: int, text: str) -> dict[str, Any]:
    return pyuff.prepare_164(
        units_code=code, units_description=text, temp_mode=1, length=1.0, force=1.0, temp=1.0, temp_offset=0.0
    )


def _nodes(numbers: np.ndarray, positions: np.ndarray) -> dict[str, Any]:
    (x, y, z), zeros = positions.T, np.zeros(len(numbers), int)
    return pyuff.prepare_15(node_nums=numbers, def_cs=zeros, disp_cs=zeros, color=zeros + 8, x=x, y=y, z=z)


def _lines(means: np.ndarray) -> list[dict[str, Any]]:
    """Return trace lines from every node to its nearest neighbours."""
    if len(means) < 2:
        return []
    _, near = cKDTree(means).query(means, min(_NEIGHBOURS, len(means) - 1) + 1)
    edges = {tuple(sorted((i, int(j)))) for i, row in enumerate(near) for j in row[1:]}
    entries = [int(e) for a, b in sorted(edges) for e in (0, FIRST_GAUSSIAN + a, FIRST_GAUSSIAN + b)]
    return [
        pyuff.prepare_82(trace_num=k + 1, n_nodes=len(some), color=8, id="neighbours", nodes=np.array(some))
        for k, some in enumerate(entries[i : i + _LINE] for i in range(0, len(entries), _LINE))
    ]


def _shape(k: int, hz: float, numbers: np.ndarray, values: np.ndarray) -> dict[str, Any]:
    return pyuff.prepare_55(
        model_type=1, id1="tg4mm operating deflection shape", id2=f"{hz:.6g} Hz, displacement, zero to peak",
        id3="NONE", id4="NONE", id5="NONE", analysis_type=5, data_ch=2, spec_data_type=_DISPLACEMENT, data_type=5,
        n_data_per_node=3, r1=values[:, 0], r2=values[:, 1], r3=values[:, 2], load_case=1, freq_step_n=k + 1, freq=hz,
        node_nums=numbers,
    )  # fmt: skip


def _at(result: SensorResult, hz: float) -> np.ndarray:
    """Return [3] phasor of a sensor's nearest peak within half of 1 / duration, in the world; else 0."""
    half = 0.5 / float(np.ptp(result.times_s))
    for peak in result.spectrum.peaks:
        if abs(peak.frequency_hz - hz) < half:
            return np.asarray(np.where(np.isfinite(peak.deviation), peak.phasor, 0) @ _frame(result.series))
    return np.zeros(3, complex)


def _functions(node: int, result: SensorResult, metres: float, unit: str) -> list[dict[str, Any]]:
    """Return the waveforms of every clock, and one spectrum, for clips the one that combines them."""
    out = []
    for c, series in enumerate(result.all_series):
        steps = np.diff(series.times_s)
        is_even = bool(np.ptp(steps) < 0.02 * steps.mean())
        of_time: dict[str, Any] = {
            "spacing": int(is_even),
            "start": float(series.times_s[0]),
            "step": float(steps.mean()),
        }
        of_time |= {"x": series.times_s, "kind": (17, "s")}
        clip = f", clip {series.clock}" if series.clock else ""
        name = f"{result.name}{clip}{_hidden(series)}"
        for k, values in enumerate((series.displacement @ _frame(series)).T * metres):
            out.append(_function(node, k + 1, c, _TIME, name, values, of_time, unit))
        for k, values in enumerate(_world_deviation(series).T * metres):
            if np.isfinite(values).all():
                out.append(_function(node, k + 1, c, _GENERAL, name, values, of_time, unit, _DEVIATION))
    name, hz, amplitudes = result.name, result.spectrum.freqs_hz, result.spectrum.amplitude
    if result.together is None:
        hz = frequency_grid(result.times_s)
        world = result.displacement @ _frame(result.series)
        amplitudes = np.abs(transformed(hz, result.times_s, world))
        name = f"{name}{_hidden(result.series)}"
    of_hz = {"x": hz, "spacing": 1, "start": 0.0, "step": float(hz[1]), "kind": (18, "Hz")}
    for k, amplitude in enumerate(amplitudes.T * metres):
        out.append(_function(node, k + 1, 0, _GENERAL, name, amplitude, of_hz, unit, _SPECTRUM))
    return out


def _frame(series: Series) -> np.ndarray:
    """Return [A, 3] unit vectors: the axes; of a flat capture x and z, as its axes may be those of a tilted plane."""
    return series.axes if len(series.axes) == 3 else np.eye(3)[[0, 2]]


def _world_deviation(series: Series) -> np.ndarray:
    """Return [T, 3] along the world's axes; not finite where a direction that is not observed takes part."""
    share = _frame(series) ** 2
    with np.errstate(invalid="ignore"):
        parts = np.where(share > 1e-12, series.deviation[:, :, None] ** 2 * share, 0.0)
    return np.asarray(np.sqrt(parts.sum(1)))


def _hidden(series: Series) -> str:
    return "" if len(series.labels) == 3 and series.is_observed.all() else ", one direction not observed"


def _function(
    node: int, direction: int, case: int, kind: int, name: str, data: np.ndarray, x: dict[str, Any],
    unit: str, what: str = _WAVEFORM,
) -> dict[str, Any]:  # fmt: skip
    return pyuff.prepare_58(
        binary=0, id1=name[:80], id2=what,
        id3="tg4mm measure", id4="NONE", id5="NONE", func_type=kind, ver_num=0, load_case_id=case, rsp_ent_name="NONE",
        rsp_node=node, rsp_dir=direction, ref_ent_name="NONE", ref_node=0, ref_dir=0, ord_data_type=4,
        num_pts=len(data), abscissa_spacing=x["spacing"], abscissa_min=x["start"], abscissa_inc=x["step"],
        z_axis_value=0.0, abscissa_spec_data_type=x["kind"][0], abscissa_axis_units_lab=x["kind"][1],
        abscissa_len_unit_exp=0, abscissa_force_unit_exp=0, abscissa_temp_unit_exp=0,
        ordinate_spec_data_type=_DISPLACEMENT, ordinate_len_unit_exp=1, ordinate_force_unit_exp=0,
        ordinate_temp_unit_exp=0, ordinate_axis_units_lab=unit, orddenom_spec_data_type=0, orddenom_len_unit_exp=0,
        orddenom_force_unit_exp=0, orddenom_temp_unit_exp=0, orddenom_axis_units_lab="NONE", z_axis_spec_data_type=0,
        z_axis_len_unit_exp=0, z_axis_force_unit_exp=0, z_axis_temp_unit_exp=0, z_axis_axis_units_lab="NONE",
        data=data, x=x["x"],
    )  # fmt: skip
