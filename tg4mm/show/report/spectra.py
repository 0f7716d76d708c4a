"""Charts of the motion: the model's spectrum, and every sensor's waveform and spectrum with its noise floor."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.even_clock import is_filled, on_even_clock
from tg4mm.core.pages.charts import CEILING, OURS, STILL, chart
from tg4mm.core.pages.page import Block, Figure, Section, Table, Text, drawing, picture
from tg4mm.core.regions import Scale
from tg4mm.run import Run
from tg4mm.show.analyse.channel import DISPLACEMENT, Channel
from tg4mm.show.analyse.spectra import Averaging, waterfall_of
from tg4mm.show.measure import Measurement, Sensor, SensorResult, measure
from tg4mm.show.measure.measurement import unit_of as unit_of_sensor
from tg4mm.show.measure.plots import parts_picture, spectrum, waveform
from tg4mm.show.measure.table import table_of
from tg4mm.show.report.summary import Material
from tg4mm.show.result.model import unit_of
from tg4mm.show.slices import amplitude_spectrum

_FEWEST = 64  # pictures of a waterfall
FALL = Averaging(overlap=0.75)
_DEEP = 60.0  # decibels below the largest amplitude


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
