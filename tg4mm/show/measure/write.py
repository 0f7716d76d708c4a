"""The files of a measurement: measure.json, files for other programs, plots, animated pictures."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.codec import before_compression
from tg4mm.core.files import to_json, write_json
from tg4mm.core.pictures.decode import write_png
from tg4mm.core.progress import progress
from tg4mm.core.work_folder import WorkFolder
from tg4mm.show.measure.clips import ClipPhases
from tg4mm.show.measure.measurement import Measurement, unit_of
from tg4mm.show.measure.plots import PLOTS, parts_picture, write_plots
from tg4mm.show.measure.sensor_result import SensorRecord, SensorResult
from tg4mm.show.measure.sensors import MeasureError
from tg4mm.show.measure.shapes import write_animations
from tg4mm.show.measure.spectrum import main_is_above
from tg4mm.show.measure.tables import format_table, write_csv_files, write_hdf5, write_mat, write_xlsx
from tg4mm.show.measure.uff import write_uff

MARK = "measure.json"
REGIONS = "regions.png"  # which part is which sensor
FORMATS: Mapping[str, tuple[str, Callable[[Measurement, Path], object]]] = {  # file of OUT, what writes it
    "csv": ("", write_csv_files),
    "uff": ("measure.uff", write_uff),
    "mat": ("measure.mat", write_mat),
    "hdf5": ("measure.h5", write_hdf5),
    "xlsx": ("measure.xlsx", write_xlsx),
}


def parse_formats(text: str) -> tuple[str, ...]:
    """Parse "csv,mat" or "csv mat". Raises MeasureError for an unknown format, and for an empty list."""
    names = tuple(dict.fromkeys(text.replace(",", " ").split()))
    for name in names or ("",):
        if name not in FORMATS:
            raise MeasureError(f"--formats {text!r}: {name!r} is no format; expected: {', '.join(FORMATS)}")
    return names


def work_folder(out: Path) -> WorkFolder:
    """Return OUT as the folder of a measurement; a second measurement replaces the first."""
    return WorkFolder(out, MARK, MeasureError)


def write_measurement(
    found: Measurement,
    out: Path,
    animate: bool = True,
    formats: Sequence[str] = tuple(FORMATS),
    plots: Sequence[str] = PLOTS,
) -> str:
    """Write all files into the folder OUT; returns the printed table and the paths.

    animate: also the shape at every peak. formats: names of `FORMATS`, plots: of `PLOTS`; files of other formats from
    an earlier measurement are removed.
    """
    write_json_file(found, out)
    with progress("files", len(FORMATS), "formats", brief=True) as update:
        for done, (name, (file, write)) in enumerate(FORMATS.items(), 1):
            if name in formats:
                write(found, out / file)
            else:
                for old in [file] if file else [f"{t}.csv" for t in ("series", "spectra", "peaks")]:
                    (out / old).unlink(missing_ok=True)
            update(done)
    write_plots(found, out, plots)
    parts = parts_picture(found)
    if parts is None:
        (out / REGIONS).unlink(missing_ok=True)
    else:
        write_png(out / REGIONS, parts)
    lines = [format_table(found)]
    if animate:
        written = write_animations(found.prepared, found.shapes, out)
        lines += [f"{path}: magnified {gain:.3g} times\n" for path, gain in written]
    return "".join([*lines, f"{out}\n"])


def write_json_file(measurement: Measurement, out: Path) -> Path:
    """Write OUT/measure.json (docs/measure.md); lengths in scene units, null for what is not observed."""
    scene, clusters = measurement.prepared, measurement.clusters
    is_judged, scale, found = bool(scene.fit.uncertainty), scene.scale, measurement.look
    value = {
        "format": "tg4mm",
        "kind": "measurement",
        "version": 1,
        "run": None if scene.folder is None else str(scene.folder),
        "unit_scale_m": measurement.unit_scale_m,
        "length_unit": "scene units",
        "printed_unit": unit_of(measurement).name,
        "marked_scale": None if scale is None else {"share": scale.share, "tilted": bool(scale.corners)},
        "reference": measurement.reference,
        "notes": list(measurement.notes),
        "clusters": {clusters.names[k]: len(v) for k, v in clusters.members.items()},
        "shapes": [
            {
                "frequency_hz": s.frequency_hz,
                "gaussians_above_floor": int(s.is_above.sum()) if is_judged else None,
            }
            for s in measurement.shapes
        ],
        "composite": None
        if found is None
        else {
            "frequency_hz": found.hz.tolist(),
            "power_over_noise": found.composite.tolist(),
            "floor": found.composite_floor,
            "cell_px": found.cell_px,
        },
        "clip_phases": None if (phases := measurement.clip_phases) is None else _clip_phases(phases),
        "sensors": [_sensor(r) for r in measurement.sensors],
    }
    path = out / MARK
    write_json(path, to_json(value, MARK))
    return path


def _clip_phases(phases: ClipPhases) -> list[dict[str, Any]]:
    """Return by how many radians every clip is ahead of the common clock, at each of the frequencies."""

    def by_clip(values: np.ndarray) -> dict[str, float]:
        return dict(zip(phases.clocks, values.tolist(), strict=True))

    columns = zip(phases.hz.tolist(), phases.radians.T, phases.deviation.T, strict=True)
    return [
        {"frequency_hz": f, "phase_rad": by_clip(angles), "deviation_rad": by_clip(sure)}
        for f, angles, sure in columns
    ]


def _sensor(result: SensorResult) -> dict[str, Any]:
    body = result.body
    return {
        "name": result.name,
        "region": str(result.sensor).partition("=")[2],
        "gaussians": int((body.weights > 0).sum()),
        "centre": body.centre.tolist(),
        "radius": body.radius,
        "axes": dict(zip(result.labels, result.axes.tolist(), strict=True)),
        "px_per_unit": result.px_per_unit,
        "best_view": result.best_view,
        "series": [_series(record) for record in result.records],
        "spectrum": {
            "window": result.spectrum.window,
            "step_hz": float(result.spectrum.freqs_hz[1]),
            "amplitude": _plain(result.spectrum.amplitude),
            "floor": _plain(result.spectrum.typical_floor),
        },
        "peaks": [_peak(result, k) for k in range(len(result.spectrum.peaks))],
        "relation": _relation(result),
    }


def _series(record: SensorRecord) -> dict[str, Any]:
    series = record.series
    return {
        "clock": series.clock,
        "axes": dict(zip(series.labels, series.axes.tolist(), strict=True)),
        "times_s": series.times_s.tolist(),
        "displacement": _plain(series.displacement),
        "deviation": _plain(series.deviation),
        "noise": _plain(series.noise[0]),
        "model_share": series.model_share.tolist(),
        "is_observed": [bool(b) for b in series.is_observed],
        "peaks": [
            {
                "frequency_hz": p.frequency_hz,
                "amplitude": p.amplitude.tolist(),
                "deviation": _plain(p.deviation),
                "phase_rad": np.angle(p.phasor).tolist(),
            }
            for p in record.peaks
        ],
        "rotation_rad": _plain(series.rotation),
        "rotation_deviation_rad": _plain(series.rotation_deviation),
    }


def _peak(result: SensorResult, k: int) -> dict[str, Any]:
    peak, orbit, damping = result.spectrum.peaks[k], result.orbits[k], result.damping[k]
    loss = result.loss_of(k)
    size, deviation = before_compression(orbit.amplitude, orbit.deviation, loss)
    gain = (None, None) if loss is None or not np.isfinite(loss.gain) else (loss.gain, loss.deviation)
    return {
        "frequency_hz": peak.frequency_hz,
        "frequency_deviation_hz": peak.frequency_deviation_hz,
        "amplitude": peak.amplitude.tolist(),
        "deviation": _plain(peak.deviation),
        "phase_rad": np.angle(peak.phasor).tolist(),
        "floor": _plain(peak.floor),
        "is_above": [bool(b) for b in peak.is_above],
        "harmonic_of_hz": getattr(peak.harmonic, "of_hz", None),
        "sideband_of_hz": getattr(peak.sideband, "of_hz", None),
        "sideband_codec_hz": getattr(peak.sideband, "codec_hz", None),
        "harmonic_order": getattr(peak.harmonic, "order", None),
        "change": getattr(peak.line, "change", None),
        "begins_s": getattr(peak.line, "start_s", None),
        "main_amplitude": size,
        "main_deviation": deviation,
        "codec_gain": gain[0],
        "codec_gain_deviation": gain[1],
        "codec_is_made": loss is not None and loss.is_made,
        "codec_mark": None if loss is None else loss.why or None,
        "main_is_above": main_is_above(peak, orbit),
        "main_direction": orbit.direction.tolist(),
        "orbit": {"major": orbit.major.tolist(), "minor": orbit.minor.tolist(), "phase_rad": orbit.phase},
        "damping_ratio": getattr(damping, "ratio", None),
        "damping_deviation": getattr(damping, "deviation", None),
        **({} if peak.requested is None else {"asked_band_hz": list(peak.requested.band)}),
    }


def _relation(result: SensorResult) -> dict[str, Any] | None:
    own = result.relation
    if own is None:
        return None
    return {
        "reference": own.reference,
        "phases": [
            {"frequency_hz": p.frequency_hz, "amplitude": p.amplitude, "phase_rad": p.phase,
             "deviation_rad": p.deviation, "is_above": p.is_above}
            for p in own.phases
        ],
        "coherence_hz": own.freqs_hz.tolist(),
        "coherence": own.coherence.tolist(),
        "segments": own.segments,
        "chance": own.chance,
    }  # fmt: skip


def _plain(values: np.ndarray | None) -> list[Any] | None:
    """Return lists of six significant digits, with None for what is not finite."""
    if values is None:
        return None
    if values.ndim > 1:
        return [_plain(v) for v in values]
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values]
