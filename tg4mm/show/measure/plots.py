"""Plots by matplotlib, one page a sensor: waveform, spectrum, orbit; and a picture of the regions."""

import io
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tg4mm.capture.look import Found
from tg4mm.capture.pictures import over_white
from tg4mm.core.files import write_atomic
from tg4mm.core.pages.charts import COLOURS, STYLE
from tg4mm.core.pictures.decode import to_bytes
from tg4mm.core.progress import progress
from tg4mm.show.measure.measurement import Measurement, Unit, unit_of
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.sensors import STILL, Sensor, file_name
from tg4mm.show.measure.series import Series
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


def write_plots(measurement: Measurement, out: Path, endings: Sequence[str] = PLOTS) -> list[Path]:
    """OUT/plots/<sensor>.svg and .png of every sensor; of a flat capture composite.svg and .png, too.

    endings: of `PLOTS`; files of the others that an earlier measurement left are removed.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder, paths = out / "plots", []
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*"):
        if old.suffix.removeprefix(".") in set(PLOTS) - set(endings):
            old.unlink()
    count = len(measurement.sensors)
    with plt.rc_context(STYLE), progress("plots", count, "sensors") as update:
        for done, result in enumerate(measurement.sensors, 1):
            figure = _figure(plt, result, unit_of(measurement, result))
            paths += _saved(plt, figure, folder / file_name(result.name), endings)
            update(done)
        if measurement.look is not None:
            paths += _saved(plt, _composite(plt, measurement.look), folder / "composite", endings)
    return paths


def _saved(plt: Any, figure: Any, stem: Path, endings: Sequence[str]) -> list[Path]:
    paths = []
    for ending in sorted(endings, reverse=True):
        data = io.BytesIO()
        figure.savefig(data, format=ending, dpi=120, metadata={"Date": None} if ending == "svg" else None)
        figure.set_layout_engine("none")  # the first picture has laid it out
        paths.append(stem.with_name(f"{stem.name}.{ending}"))
        write_atomic(paths[-1], partial(Path.write_bytes, data=data.getvalue()))
    plt.close(figure)
    return paths


def _composite(plt: Any, found: Found) -> Any:
    figure = plt.figure(figsize=(10, 4), layout="constrained")
    composite(figure.add_subplot(), found)
    return figure


def _figure(plt: Any, result: SensorResult, unit: Unit) -> Any:
    figure = plt.figure(figsize=(10, 6), layout="constrained")
    grid = figure.add_gridspec(2, 3)
    figure.suptitle(f"{result.name}: {result.extent}", x=0.01, ha="left", weight="bold")
    waveform(figure.add_subplot(grid[0, :]), result, unit)
    spectrum(figure.add_subplot(grid[1, :2]), result, unit)
    _orbit(figure.add_subplot(grid[1, 2]), result, unit)
    return figure


def _told(series: Series) -> list[int]:
    """Axes worth drawing: observed, and not uncertain by more than ten times the best one."""
    return np.flatnonzero(series.is_resolved).tolist()


def waveform(axes: Any, result: SensorResult, unit: Unit) -> None:
    """Displacement over time with a band of one standard deviation; of clips the first one's."""
    series = result.series
    marker = "." if len(series.times_s) <= _MARKED else ""
    hidden = [series.labels[k] for k in range(len(series.labels)) if k not in _told(series)]
    for k in _told(series):
        value, error = series.displacement[:, k] * unit.factor, series.deviation[:, k] * unit.factor
        axes.plot(
            series.times_s, value, color=COLOURS[k], lw=1.2, marker=marker, ms=3, label=series.labels[k]
        )
        axes.fill_between(series.times_s, value - error, value + error, color=COLOURS[k], alpha=0.25, lw=0)
    axes.set(xlabel="time, s", ylabel=f"displacement, {unit.name}")
    words = [f"clip {series.clock}"] if series.clock else []
    words += ["band: one standard deviation"]
    words += [f"{', '.join(hidden)} hardly seen, left out"] if hidden else []
    axes.set_title("; ".join(words), fontsize=8, loc="left")
    if _told(series):
        axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2, frameon=False)
    if unit.name != "px":
        scale = result.px_per_unit / unit.factor
        second = axes.secondary_yaxis("right", functions=(lambda v: v * scale, lambda v: v / scale))
        second.set_ylabel(f"px in {result.best_view}")


def spectrum(axes: Any, result: SensorResult, unit: Unit) -> None:
    """Amplitude over frequency, noise floor dashed, peaks named."""
    found = result.spectrum
    told = np.flatnonzero(is_resolved(found.typical_floor)).tolist()
    for k in told:
        axes.semilogy(
            found.freqs_hz, np.maximum(found.amplitude[:, k] * unit.factor, 1e-12), color=COLOURS[k], lw=1.1,
            label=result.labels[k],
        )  # fmt: skip
        floor = found.floor[:, k] * unit.factor
        axes.semilogy(
            found.freqs_hz, floor, color=COLOURS[k], lw=1, ls=(0, (4, 3)), label=f"{result.labels[k]}, floor"
        )
    lowest = min((float(found.typical_floor[k]) for k in told), default=1e-9) * unit.factor
    top = max((float(found.amplitude[:, k].max()) for k in told), default=1.0) * unit.factor
    lowest = min(lowest, top) if lowest > 0 else top / 1e4
    for peak, orbit in zip(found.peaks, result.orbits, strict=True):
        axes.annotate(
            f"{peak.frequency_hz:.4g} Hz", (peak.frequency_hz, orbit.amplitude * unit.factor), fontsize=8,
            ha="center", xytext=(0, 6), textcoords="offset points",
        )  # fmt: skip
    axes.set_ylim(lowest / 10, max(top, lowest) * 4)
    axes.set(xlabel="frequency, Hz", ylabel=f"amplitude, {unit.name}", xlim=(0, found.freqs_hz[-1]))
    axes.set_title("dashed: noise floor; peaks below it are not significant", fontsize=8, loc="left")


def _orbit(axes: Any, result: SensorResult, unit: Unit) -> None:
    series = result.series
    told, size = _told(series), np.abs(series.displacement).max(0)
    pair = sorted(sorted(told, key=lambda k: -size[k])[:2])
    if len(pair) < 2:
        axes.set_axis_off()
        return
    a, b = pair
    axes.plot(
        series.displacement[:, a] * unit.factor,
        series.displacement[:, b] * unit.factor,
        ".",
        ms=3,
        color="#777777",
    )
    turn = np.exp(2j * np.pi * np.arange(65) / 64)
    for peak in result.records[0].peaks[:3]:
        axes.plot(
            (peak.phasor[a] * turn).real * unit.factor, (peak.phasor[b] * turn).real * unit.factor, lw=1.3,
            label=f"{peak.frequency_hz:.4g} Hz",
        )  # fmt: skip
    axes.set(xlabel=f"{series.labels[a]}, {unit.name}", ylabel=f"{series.labels[b]}, {unit.name}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=4)
    axes.set_title("orbit", fontsize=8, loc="left")
    if result.spectrum.peaks:
        axes.legend(fontsize=7)


def parts_picture(found: Measurement) -> np.ndarray | None:
    """The scene at rest, [h, w, 3] uint8, with the sensors' regions in colour and their names; None without any.

    From the camera that sees most of them. What stands still and the whole scene are no regions.
    """
    parts = [s for s in found.sensors if _is_part(s.sensor)]
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
    some = np.unique(np.linspace(0, len(frames) - 1, min(_CAMERAS, len(frames))).round().astype(int))
    cameras = [Camera.of(frames[i], scene.observations.size) for i in some]
    maps = [render_features(scene.gaussians, features, camera)[0] for camera in cameras]
    best = int(np.argmax([np.sqrt((own > _VISIBLE).sum((0, 1))).sum() for own in maps]))
    camera, shares = cameras[best], maps[best]
    rest = render_image(scene.gaussians, camera.viewmat, camera.K, width, height)
    return _coloured(rest, shares, [part.name for part in parts])


def _coloured(rest: np.ndarray, shares: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """A picture [H, W, 3] in which pixels with a large share [H, W, S] of a region have its colour, and its name."""
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


def _is_part(sensor: Sensor) -> bool:
    return sensor.region != "all" and (sensor.region, sensor.values) != ("cluster", (float(STILL),))
