"""The sections on the capture and the motion, with the model's spectrum and every sensor's waveform and spectrum."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from tg4mm.core.digits import number
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.even_clock import is_filled, on_even_clock
from tg4mm.core.pages.charts import CEILING, MUTED, OURS, STILL, chart, colour_bar, phase_bar
from tg4mm.core.pages.page import Block, Figure, Section, Table, Text, drawing, film, picture
from tg4mm.core.phasors import main_direction, scale_top
from tg4mm.core.pictures.decode import read_png
from tg4mm.core.regions import Scale
from tg4mm.run import Run
from tg4mm.show.analyse.channel import DISPLACEMENT, Channel
from tg4mm.show.analyse.transfer import Averaging, waterfall_of
from tg4mm.show.maps import Axis, amplitude_spectrum, evenly, leading_modes, motion_maps, uncertainty_map
from tg4mm.show.measure import Measurement, Sensor, SensorResult, measure
from tg4mm.show.measure.measurement import unit_of as unit_of_sensor
from tg4mm.show.measure.plots import parts_picture, spectrum, waveform
from tg4mm.show.measure.tables import table_of
from tg4mm.show.report.figures import (
    SliceLine,
    contact_sheet,
    line_that_moves,
    map_picture,
    marked,
    phase_picture,
    slice_picture,
)
from tg4mm.show.report.sources import contact_images
from tg4mm.show.report.summary import Material, vector, vibrations_table
from tg4mm.show.result.model import unit_of

_FEWEST = 64  # pictures of a waterfall
FALL = Averaging(overlap=0.75)
_DEEP = 60.0  # decibels below the largest amplitude
_LEAST = 24  # pictures of a slice; a shorter record is repeated
_POINTS = 250  # drawn Gaussians
_ARROWS = 60  # cameras with a line of sight
_VIEWS = (("From above", 0, 1), ("From the side", 0, 2))  # title and the two world axes


def model_spectrum(m: Material) -> Block:
    """Return the model's modes over frequency, with the vibrations and the noise of a mode."""
    assert m.model.motion is not None
    unit, factor = unit_of(m.train)
    freqs, amplitudes = amplitude_spectrum(m.model.motion, m.model.weights)
    inside = m.view.magnified.inside(freqs) & (freqs > 0)
    noise = None if m.result.noise is None else m.result.noise * factor

    def draw(axes: Any) -> None:
        for rows, colour in ((inside, OURS), (~inside, STILL)):
            axes.vlines(freqs[rows], 0, amplitudes[rows] * factor, color=colour, lw=2.5)
            axes.plot(freqs[rows], amplitudes[rows] * factor, "o", ms=4, color=colour)
        if noise is not None:
            axes.axhline(noise, color=CEILING, lw=1, ls=(0, (4, 3)))
        for v in m.result.vibrations:
            at = v.hz, amplitudes[int(np.argmin(np.abs(freqs - v.hz)))] * factor
            axes.annotate(f"{v.hz:.4g} Hz", at, ha="center", xytext=(0, 7), textcoords="offset points")
        top = max(float(amplitudes.max(initial=0)) * factor, noise or 0.0) or 1.0
        axes.set(xlabel="frequency, Hz", ylabel=f"mean amplitude, {unit}", ylim=(0, 1.18 * top))
        axes.set_xlim(left=0, right=m.train.fps / 2)

    caption = (
        "Spectrum of the model: peak displacement at each of its frequencies, averaged over all Gaussians with their "
        "blending weight in the training views. Static parts count, so the mean lies well below the amplitude of "
        "moving parts. Coloured lines are magnified"
        + (" (every frequency)." if m.band is None else f" ({m.band[0]:g} to {m.band[1]:g} Hz).")
    )
    if noise is not None:
        caption += " Dashed: the noise floor of a Gaussian, median of the visible."
    drawn = chart(draw, "amplitude of the model over frequency", (6.6, 3.0), zooms=True)
    return Figure([drawing(drawn)], caption, width="narrow")


def sensors_section(m: Material) -> list[Section]:
    """Return waveforms and spectra of every sensor, and the table that `tg4mm measure` prints; [] without sensors."""
    if m.measurement is None:
        return []
    found = m.measurement
    words = (
        "Virtual sensors: regions whose motion is measured in the pictures frame by frame, not taken from the fitted "
        "modes, so it is not smoothed or confined to a band. Without --sensor they are the parts that move alike, the "
        "static part, and the complete scene."
    )
    blocks: list[Block] = [Text(words), _peaks(found)]
    parts = parts_picture(found)
    if parts is not None:
        caption = "Which part is which sensor: coloured and named, in the camera that sees most of them."
        blocks.insert(1, Figure([picture(parts, alt="which part is which sensor", photo=True)], caption))
    blocks += [_figure(found, result) for result in found.sensors]
    return [Section("The sensors", blocks)]


def _peaks(found: Measurement) -> Table:
    head, *rows = table_of(found)
    header = [*head[:-1], "remark"]
    caption = (
        f"Peaks above the noise floor; amplitudes zero to peak along each orbit's main axis, ± one standard deviation; "
        f"phases against {found.reference}."
    )
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    return Table(header, rows, caption, left=len(head))


def _figure(found: Measurement, result: SensorResult) -> Figure:
    name, unit = result.name, unit_of_sensor(found, result)
    parts = {"displacement over time": waveform, "amplitude over frequency with noise floor": spectrum}
    panels = [
        drawing(chart(partial(draw, result=result, unit=unit), f"{name}: {label}", zooms=True))
        for label, draw in parts.items()
    ]
    if fall := _waterfall(result):
        along, draw = fall
        label = f"{name}: amplitude along {along} over time and frequency"
        panels.append(drawing(chart(draw, label, (11.2, 3.3), True)))
    caption = (
        f"Sensor “{name}”, {result.extent} around ({', '.join(f'{c:.3g}' for c in result.body.centre)}), radius "
        f"{result.body.radius:.3g} scene units: displacement with a band of one standard deviation, and its spectrum "
        "with the noise floor, which noise alone exceeds in one record of a hundred."
    )
    if n := len(result.clips):
        caption += f" The waveform is that of the first of {n} clips, the spectrum combines all of them."
    if fall:
        caption += (
            f" Below: waterfall along {fall[0]}, yellow the largest amplitude, darkest {_DEEP:g} dB below it; each "
            f"segment shares {FALL.overlap:.0%} with the next."
        )
    return Figure(panels, caption, 2)


def _waterfall(result: SensorResult) -> tuple[str, Callable[[Any], None]] | None:
    """Return the direction of the largest motion, and a function that draws its amplitudes in short segments.

    None for few samples or long gaps.
    """
    series, resolved = result.series, result.series.is_resolved
    if not resolved.any() or len(series.times_s) <= _FEWEST or not is_filled(series.times_s):
        return None
    k = int(np.argmax(np.where(resolved, series.displacement.std(0), -1)))
    even = on_even_clock(series.times_s, series.displacement[:, k])
    own = Channel(result.name, DISPLACEMENT, "units", *even)
    freqs, times, amplitude = waterfall_of(own, FALL)
    if len(times) < 2 or not amplitude.max() > 0:
        return None
    decibels = 20 * np.log10(np.maximum(amplitude / amplitude.max(), 10 ** (-_DEEP / 20)))

    def draw(axes: Any) -> None:
        mesh = axes.pcolormesh(times, freqs, decibels, cmap="viridis", vmin=-_DEEP, vmax=0, rasterized=True)
        axes.figure.colorbar(mesh, ax=axes, label="dB below the largest")
        axes.set(xlabel="time, s", ylabel="frequency, Hz")

    return series.labels[k], draw


def measured(
    run: Run, sensors: Sequence[Sensor], band: tuple[float, float] | None = None, scale: Scale | None = None
) -> tuple[Measurement | None, str]:
    """Measure the run, or return a reason why not. Raises Tg4mmError for requested sensors that cannot be measured."""
    try:
        return measure(run, sensors or None, band=band, scale=scale), ""
    except Tg4mmError as error:
        if sensors:
            raise
        return None, f"sensors: {error}"


def capture_section(m: Material) -> Section:
    """Return the contact sheet, the recording's figures and the camera map."""
    t = m.train
    images = contact_images(t)
    views = len(set(t.camera_ids.tolist()))
    many = f"{len(images)} of the {views}" if len(images) < views else f"the {views}"
    scale = "unknown, so lengths are in scene units"
    if t.unit_scale_m is not None:
        scale = f"1 scene unit = {number(t.unit_scale_m)} m"
    steps = "one timestep"
    if t.n_timesteps > 1:
        rate = f"{number(t.fps)} Hz, {number(t.n_timesteps / t.fps)} s" if t.fps > 0 else "frame rate unknown"
        steps = f"{t.n_timesteps} timesteps ({rate})"
    count = "1 image" if len(t.paths) == 1 else f"{len(t.paths)} images"
    cameras = "1 training camera" if views == 1 else f"{views} training cameras"
    words = f"{cameras}, {steps}: {count} of {t.width} × {t.height} pixels. Scale: {scale}."
    caption = f"Training views: {many} cameras at their first timestep, in the order of the dataset."
    sheet = contact_sheet(images, columns=_columns(len(images)))
    shown = Figure([picture(sheet, alt="training views", photo=True)], caption)
    return Section("The capture", [Text(words), shown, camera_map(m)])


def _columns(n: int) -> int:
    """Return the number of columns, 5 to 10, with the fewest gaps in the last row; of several the largest."""
    return min(range(10, 4, -1), key=lambda c: -n % c) if n > 6 else max(n, 1)


def motion_section(m: Material) -> Section:
    """Return slices, maps and spectrum; one sentence for a capture without motion."""
    if m.model.motion is None:
        return Section("The motion", [Text(m.why_still)])
    blocks: list[Block] = [slices(m), *vibrations_table(m), _maps(m), model_spectrum(m)]
    if m.orbit is not None:
        blocks.append(_orbit(m.orbit))
    return Section("The motion", blocks)


def _leading(m: Material) -> list[int]:
    """Return the modes to map: the strongest magnified vibrations, two at most, else the strongest modes."""
    assert m.model.motion is not None
    freqs = m.model.motion.freqs_hz
    inside = m.view.magnified.inside(freqs)
    found = [int(np.argmin(np.abs(freqs - v.hz))) for v in m.result.vibrations]
    magnified = [k for k in found if inside[k]][:2]
    return magnified or leading_modes(m.model.motion, m.model.weights, m.view.magnified)


def _maps(m: Material) -> Block:
    motion = m.model.motion
    assert motion is not None
    seen = []
    for k in _leading(m):
        direction = main_direction(motion.displacement_of(k), m.model.weights)
        seen.append((k, direction, motion_maps(m.model.gaussians, motion, k, direction, m.view.camera)))
    top = max(scale_top(maps.amplitude, maps.opacity) for _, _, maps in seen)
    panels, axes = [], []
    for k, direction, maps in seen:
        name = f"{number(float(motion.freqs_hz[k]))} Hz"
        strength = maps.amplitude / top if top > 0 else np.zeros_like(maps.amplitude)
        shown = (
            map_picture(maps.amplitude, top, maps.opacity),
            phase_picture(maps.phase, strength, maps.opacity),
        )
        for what, one in zip(("amplitude", "phase"), shown, strict=True):
            panels.append(
                picture(one, f"{what.title()} at {name}", f"map of the {what} at {name}", photo=True)
            )
        axes.append(f"({vector(direction)}) at {name}")
    caption = (
        "The motion of the surface under each pixel, in 3D, read from the model and not from the picture: "
        "peak displacement (the colour scale ends at its 99.5th percentile), and phase at timestep 0 of the "
        f"motion along {', '.join(axes)}, fading to grey below 20 % of the amplitude scale. Parts in step share "
        "one colour; parts half a turn (180°) apart move against each other."
    )
    if m.model.uncertainty is not None:
        unsure = uncertainty_map(m.model.gaussians, m.model.uncertainty, m.view.camera)
        one = map_picture(unsure, top, seen[0][2].opacity)
        panels.append(picture(one, "Uncertainty", "map of the uncertainty", photo=True))
        caption += (
            " Uncertainty is one standard deviation of the displacement, as estimated by the run, as the peak of a "
            "sinusoid, in the colours of the amplitude: where both are equally bright, the motion is unreliable."
        )
    unit, factor = unit_of(m.train)
    bars = colour_bar(top * factor, unit, "peak displacement"), phase_bar()
    return Figure(panels, caption, legend=Markup('<div class="pair">{}{}</div>').format(*bars))


def _orbit(folder: Path) -> Block:
    first = read_png(folder / "r_000.png")
    panel = film((folder / "orbit.mp4").read_bytes(), first, alt="the scene from a moving camera")
    caption = "The magnified motion from a camera that no image was taken from, moving around the scene."
    return Figure([panel], caption, width="small", controls=True)


def slices(m: Material) -> Block:
    """Return one figure; for a moving camera, slices of the model from one pose."""
    named = _named(m)
    shown = next(video for label, video in reversed(named) if video is not None)
    line = line_that_moves(shown, _axis_of_motion(m))
    periods = max(1, math.ceil(_LEAST / len(shown))) if len(shown) == m.train.n_timesteps else 1
    shape = f"{m.train.width} / {m.train.height}"  # as tall as the reference beside them
    panels = [picture(marked(shown[0], line), "Where the slices are cut", photo=True)]
    panels += [
        picture(slice_picture(video, line, periods), label, f"space-time slice: {label}", True, shape)
        for label, video in named
    ]
    return Figure(panels, _caption(m, line, periods * len(shown) / m.train.fps))


def _axis_of_motion(m: Material) -> Axis | None:
    """Return "row" if the strongest vibration is more horizontal than vertical in the picture, else "column"."""
    motion = m.model.motion
    if motion is None or m.main is None:
        return None
    k = int(np.argmin(np.abs(motion.freqs_hz - m.main.hz)))
    right, down, _ = m.view.camera.viewmat[:3, :3] @ main_direction(
        motion.displacement_of(k), m.model.weights
    )
    return "row" if abs(right) >= abs(down) else "column"


def _named(m: Material) -> list[tuple[str, np.ndarray]]:
    magnified = f"α = {m.view.alpha:g}"
    if m.view.fixed is not None:
        still, ours = m.view.fixed
        return [("The model from one pose, α = 0", still), (f"The same, {magnified}", ours)]
    found = [("Input", m.view.input), (f"Ours, {magnified}", m.view.ours)]
    found.append((f"Ground truth, {magnified}", m.view.truth))
    return [(label, video) for label, video in found if video is not None]


def _caption(m: Material, line: SliceLine, seconds: float) -> Markup:
    time = "Time runs to the right" if line.axis == "column" else "Time runs down"
    words = Markup(
        "Space-time slices: the pixels of {} {} (marked; {} to {}) over {} s. {}. "
        "What stands still draws straight lines; vibration draws waves, {} times as high after magnification."
    ).format(line.axis, line.index, line.start, line.stop - 1, number(seconds), time, f"{1 + m.view.alpha:g}")
    if m.view.fixed is not None:
        words += " The camera moved, so both slices are of the model, rendered from the pose that sees most motion."
    if m.view.truth is not None:
        words += (
            " Waves should agree with the truth in height and phase; fringes and blur beside them are errors."
        )
    return words


def camera_map(m: Material) -> Block:
    """Return two charts side by side, lengths in metres if the scale is known."""
    scale = m.train.unit_scale_m
    factor, unit = (1.0, "scene units") if scale is None else (scale, "m")
    viewmats = m.train.viewmats[np.unique(m.train.camera_ids, return_index=True)[1]]
    eyes = -np.einsum("cij,ci->cj", viewmats[:, :3, :3], viewmats[:, :3, 3]) * factor
    points = _points(m) * factor
    low, high = np.percentile(points, [1, 99], axis=0)
    reach = 0.25 * float(np.median(np.linalg.norm(eyes - (low + high) / 2, axis=1)))
    tips, shown = eyes + reach * viewmats[:, 2, :3], m.view.camera.position * factor
    tip, arrows = shown + reach * m.view.camera.forward, evenly(len(eyes), _ARROWS)

    def draw(axes: Any, a: int, b: int) -> None:
        axes.plot(points[:, a], points[:, b], ".", ms=1.6, color=STILL, zorder=1)
        across, up = [low[a], high[a], high[a], low[a], low[a]], [low[b], low[b], high[b], high[b], low[b]]
        axes.plot(across, up, color=CEILING, lw=1.1, label="Gaussians, 98 % on each axis")
        for eye, end in zip(eyes[arrows], tips[arrows], strict=True):
            axes.plot([eye[a], end[a]], [eye[b], end[b]], color=MUTED, lw=0.7)
        axes.plot(eyes[:, a], eyes[:, b], "s", ms=3.2, color=MUTED, label="training cameras")
        axes.plot([shown[a], tip[a]], [shown[b], tip[b]], color=OURS, lw=1.4)
        axes.plot(shown[a], shown[b], "o", ms=6, color=OURS, label="the camera shown here")
        axes.set(xlabel=f"{'xyz'[a]}, {unit}", ylabel=f"{'xyz'[b]}, {unit}")
        axes.set_aspect("equal", adjustable="datalim")

    charts = []
    for title, a, b in _VIEWS:
        label = f"cameras and Gaussians {title.lower()}"
        charts.append(drawing(chart(partial(draw, a=a, b=b), label, (5.0, 4.2)), title))
    caption = (
        "Camera map in the world's axes, z up: squares are training cameras with their lines of sight, the large dot "
        "is the camera of the videos and maps, the box holds 98 % of the visible Gaussians on each axis, small dots "
        "are some of them."
    )
    return Figure(charts, caption)


def _points(m: Material) -> np.ndarray:
    """Draw some Gaussians [n, 3] by their blending weight."""
    means = m.model.gaussians.means.numpy().astype(np.float64)
    weights = np.maximum(m.model.weights, 0).astype(np.float64)
    if not weights.sum() > 0:
        weights = np.ones(len(means))
    chosen = np.random.default_rng(0).choice(len(means), _POINTS, p=weights / weights.sum())
    return means[chosen]
