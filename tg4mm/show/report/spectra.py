"""Charts of the motion: the model's spectrum, and every sensor's waveform and spectrum with its noise floor."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.pages.charts import CEILING, OURS, STILL, chart
from tg4mm.core.pages.page import Block, Figure, Section, Table, Text, drawing
from tg4mm.core.scale import Scale
from tg4mm.run import Run
from tg4mm.show.measure import Measurement, Sensor, SensorResult, measure
from tg4mm.show.measure.plots import spectrum, waveform
from tg4mm.show.measure.table import table_of
from tg4mm.show.measure.units import unit_of as unit_of_sensor
from tg4mm.show.report.summary import Material
from tg4mm.show.result.model import unit_of
from tg4mm.show.slices import amplitude_spectrum


def model_spectrum(m: Material) -> Block:
    """The model's modes over frequency, the vibrations found among them, and the noise of a mode."""
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
            height = amplitudes[int(np.argmin(np.abs(freqs - v.hz)))] * factor
            axes.annotate(
                f"{v.hz:.4g} Hz", (v.hz, height), ha="center", xytext=(0, 7), textcoords="offset points"
            )
        top = max(float(amplitudes.max(initial=0)) * factor, noise or 0.0) or 1.0
        axes.set(xlabel="frequency, Hz", ylabel=f"mean amplitude, {unit}", ylim=(0, 1.18 * top))
        axes.set_xlim(left=0, right=m.train.fps / 2)

    caption = (
        "Spectrum of the model: peak displacement at each of its frequencies, averaged over all Gaussians with their "
        "blending weight in the training views. Standing parts count, so the mean lies well below the amplitude of "
        "what moves. Coloured lines are magnified"
        + (" (every frequency)." if m.band is None else f" ({m.band[0]:g} to {m.band[1]:g} Hz).")
    )
    if noise is not None:
        caption += " Dashed: the noise floor of a Gaussian, median of what is seen."
    return Figure(
        [drawing(chart(draw, "amplitude of the model over frequency", (6.6, 3.0)))], caption, width="narrow"
    )


def sensors_section(m: Material) -> list[Section]:
    """Waveforms and spectra of every sensor, and their peaks as `tg4mm measure` prints them; [] without any."""
    if m.measurement is None:
        return []
    found = m.measurement
    words = (
        "Virtual sensors: regions whose motion is read from the pictures frame by frame, not from the fitted modes, so "
        "nothing in them is smoothed or confined to a band. Without --sensor they are the parts that move alike, what "
        "stands still, and the whole scene."
    )
    blocks: list[Block] = [Text(words), _peaks(found)]
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
    unit = unit_of_sensor(found, result)
    count = int((result.body.weights > 0).sum())
    name = result.name
    panels = [
        drawing(chart(lambda axes: waveform(axes, result, unit), f"{name}: displacement over time")),
        drawing(
            chart(
                lambda axes: spectrum(axes, result, unit),
                f"{name}: amplitude over frequency with noise floor",
            )
        ),
    ]
    clips = (
        f" The waveform is that of the first of {len(result.clips)} clips, the spectrum of all of them together."
        if result.clips
        else ""
    )
    caption = (
        f"Sensor “{name}”, {count:,} Gaussians around ({', '.join(f'{c:.3g}' for c in result.body.centre)}), radius "
        f"{result.body.radius:.3g} scene units: displacement with a band of one standard deviation, and its spectrum "
        f"with the noise floor, which noise alone passes in one record of a hundred.{clips}"
    )
    return Figure(panels, caption)


def measured(
    run: Run, sensors: Sequence[Sensor], band: tuple[float, float] | None = None, scale: Scale | None = None
) -> tuple[Measurement | None, str]:
    """What sensors measure on the run, or why nothing was. Sensors that were asked for must be measured: Tg4mmError."""
    try:
        return measure(run, sensors or None, band=band, scale=scale), ""
    except Tg4mmError as error:
        if sensors:
            raise
        return None, f"sensors: {error}"
