"""Plots by matplotlib, one page a sensor: waveform, spectrum, orbit; and a picture of the regions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tg4mm.capture.pictures import over_white
from tg4mm.core.pages.charts import COLOURS, pyplot, save
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.core.progress import progress
from tg4mm.show.maps import evenly
from tg4mm.show.measure.measurement import Measurement, MeasurementUnit, unit_of
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.sensors import STILL, file_name
from tg4mm.show.measure.spectrum import is_resolved
from tg4mm.show.regions import COLOURS as REGION_COLOURS
from tg4mm.show.regions import composite, write_labels
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_features, render_image

PLOTS = ("png", "svg")  # files of each
_MARKED = 200  # samples: of a longer record they would run into each other
_EDGE = 720  # pixels of the longer side, about
_TINT, _PALE = 0.55, 0.35  # of a region's colour, and of white in the rest of the picture
_CAMERAS = 6  # that are tried
_VISIBLE = 0.3  # of what a pixel shows: it belongs to the region


def write_plots(measurement: Measurement, out: Path, endings: Sequence[str] = PLOTS) -> None:
    """Write OUT/plots/<sensor>.svg and .png for every sensor, and composite.svg and .png for a flat capture.

    endings: of `PLOTS`; files of the others that an earlier measurement left are removed.
    """
    folder = out / "plots"
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*"):
        if old.suffix.removeprefix(".") in set(PLOTS) - set(endings):
            old.unlink()
    with pyplot() as plt, progress("plots", len(measurement.sensors), "sensors") as update:
        for done, result in enumerate(measurement.sensors, 1):
            figure = _figure(plt, result, unit_of(measurement, result))
            save(
                plt, figure, [folder / f"{file_name(result.name)}.{e}" for e in sorted(endings, reverse=True)]
            )
            update(done)
        if measurement.look is not None:
            figure = plt.figure(figsize=(10, 4), layout="constrained")
            composite(figure.add_subplot(), measurement.look)
            save(plt, figure, [folder / f"composite.{e}" for e in sorted(endings, reverse=True)])


def _figure(plt: Any, result: SensorResult, unit: MeasurementUnit) -> Any:
    figure = plt.figure(figsize=(10, 6), layout="constrained")
    grid = figure.add_gridspec(2, 3)
    figure.suptitle(f"{result.name}: {result.extent}", x=0.01, ha="left", weight="bold")
    waveform(figure.add_subplot(grid[0, :]), result, unit)
    spectrum(figure.add_subplot(grid[1, :2]), result, unit)
    _orbit(figure.add_subplot(grid[1, 2]), result, unit)
    return figure


def waveform(axes: Any, result: SensorResult, unit: MeasurementUnit) -> None:
    """Draw displacement over time with a band of one standard deviation; of the first clip if there are several."""
    series = result.series
    marker = "." if len(series.times_s) <= _MARKED else ""
    resolved = np.flatnonzero(series.is_resolved).tolist()
    hidden = [label for k, label in enumerate(series.labels) if k not in resolved]
    for k in resolved:
        value, error = series.displacement[:, k] * unit.factor, series.deviation[:, k] * unit.factor
        style = {"color": COLOURS[k], "lw": 1.2, "marker": marker, "ms": 3, "label": series.labels[k]}
        axes.plot(series.times_s, value, **style)
        axes.fill_between(series.times_s, value - error, value + error, color=COLOURS[k], alpha=0.25, lw=0)
    axes.set(xlabel="time, s", ylabel=f"displacement, {unit.name}")
    title = [f"clip {series.clock}"] if series.clock else []
    title += ["band: one standard deviation"]
    title += [f"{', '.join(hidden)} hardly seen, left out"] if hidden else []
    axes.set_title("; ".join(title), fontsize=8, loc="left")
    if resolved:
        axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2, frameon=False)
    if unit.name != "px":
        scale = result.px_per_unit / unit.factor
        second = axes.secondary_yaxis("right", functions=(lambda v: v * scale, lambda v: v / scale))
        second.set_ylabel(f"px in {result.best_view}")


def spectrum(axes: Any, result: SensorResult, unit: MeasurementUnit) -> None:
    """Draw amplitude over frequency with the noise floor dashed and the peaks' frequencies."""
    found = result.spectrum
    resolved = np.flatnonzero(is_resolved(found.typical_floor)).tolist()
    for k in resolved:
        label, colour = result.labels[k], COLOURS[k]
        amplitude, floor = (
            np.maximum(found.amplitude[:, k] * unit.factor, 1e-12),
            found.floor[:, k] * unit.factor,
        )
        axes.semilogy(found.freqs_hz, amplitude, color=colour, lw=1.1, label=label)
        axes.semilogy(found.freqs_hz, floor, color=colour, lw=1, ls=(0, (4, 3)), label=f"{label}, floor")
    lowest = min((float(found.typical_floor[k]) for k in resolved), default=1e-9) * unit.factor
    top = max((float(found.amplitude[:, k].max()) for k in resolved), default=1.0) * unit.factor
    lowest = min(lowest, top) if lowest > 0 else top / 1e4
    for peak, orbit in zip(found.peaks, result.orbits, strict=True):
        axes.annotate(
            f"{peak.frequency_hz:.4g} Hz", (peak.frequency_hz, orbit.amplitude * unit.factor), fontsize=8,
            ha="center", xytext=(0, 6), textcoords="offset points",
        )  # fmt: skip
    axes.set_ylim(lowest / 10, max(top, lowest) * 4)
    axes.set(xlabel="frequency, Hz", ylabel=f"amplitude, {unit.name}", xlim=(0, found.freqs_hz[-1]))
    axes.set_title("dashed: noise floor; peaks below it are not significant", fontsize=8, loc="left")


def _orbit(axes: Any, result: SensorResult, unit: MeasurementUnit) -> None:
    series = result.series
    resolved, size = np.flatnonzero(series.is_resolved).tolist(), np.abs(series.displacement).max(0)
    if len(resolved) < 2:
        axes.set_axis_off()
        return
    a, b = sorted(sorted(resolved, key=lambda k: -size[k])[:2])
    x, y = series.displacement[:, [a, b]].T * unit.factor
    axes.plot(x, y, ".", ms=3, color="#777777")
    turn = np.exp(2j * np.pi * np.arange(65) / 64)
    for peak in result.records[0].peaks[:3]:
        x, y = (np.outer(peak.phasor[[a, b]], turn)).real * unit.factor
        axes.plot(x, y, lw=1.3, label=f"{peak.frequency_hz:.4g} Hz")
    axes.set(xlabel=f"{series.labels[a]}, {unit.name}", ylabel=f"{series.labels[b]}, {unit.name}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=4)
    axes.set_title("orbit", fontsize=8, loc="left")
    if result.spectrum.peaks:
        axes.legend(fontsize=7)


def parts_picture(found: Measurement) -> np.ndarray | None:
    """Draw the scene at rest, [h, w, 3] uint8, with the sensors' regions in colour and their names; None without any.

    From the camera that sees most of them. The static cluster and the complete scene are no regions.
    """
    static = "cluster", (float(STILL),)
    parts = [
        s for s in found.sensors if s.sensor.region != "all" and (s.sensor.region, s.sensor.values) != static
    ]
    if not parts:
        return None
    scene = found.prepared
    if not scene.capture.kind.sees_depth:
        masks = np.stack([s.mask for s in parts if s.mask is not None], -1)
        raw = scene.observations.pictures.strips(scene.observations.frames[0].rows[:1].tolist())
        first = over_white(raw(slice(None)), scene.observations.pictures.maximum)[0]
        return _coloured(first, masks, [part.name for part in parts])
    features = np.stack([np.clip(s.body.weights, 0, 1) for s in parts], 1).astype(np.float32)
    frames, (width, height) = scene.observations.frames, scene.observations.size
    cameras = [Camera.of(frames[i], scene.observations.size) for i in evenly(len(frames), _CAMERAS)]
    maps = [render_features(scene.gaussians, features, camera)[0] for camera in cameras]
    best = int(np.argmax([np.sqrt((own > _VISIBLE).sum((0, 1))).sum() for own in maps]))
    camera, shares = cameras[best], maps[best]
    rest = render_image(scene.gaussians, camera.viewmat, camera.K, width, height)
    return _coloured(rest, shares, [part.name for part in parts])


def _coloured(rest: np.ndarray, shares: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Tint pixels of a picture [H, W, 3] with a large share [H, W, S] of a region in its colour, and write its name."""
    height, width = rest.shape[:2]
    shown = np.repeat(rest.mean(2, keepdims=True), 3, 2) * (1 - _PALE) + _PALE
    labels = []
    for k, name in enumerate(names):
        inside = (shares[..., k] > _VISIBLE) & (shares[..., k] >= shares.max(2))
        colour = np.array(REGION_COLOURS[k % len(REGION_COLOURS)]) / 255
        shown[inside] = (1 - _TINT) * shown[inside] + _TINT * colour
        if inside.any():
            rows, columns = np.nonzero(inside)
            near = np.argmin((rows - np.median(rows)) ** 2 + (columns - np.median(columns)) ** 2)
            labels.append((name, (float(columns[near]), float(rows[near]))))
    scale = max(1, round(_EDGE / max(width, height)))
    out = Image.fromarray(to_bytes(shown)).resize((scale * width, scale * height), Image.Resampling.BICUBIC)
    write_labels(out, [(name, (scale * x, scale * y)) for name, (x, y) in labels])
    return np.asarray(out)
