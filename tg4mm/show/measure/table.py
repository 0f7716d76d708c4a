"""What `tg4mm measure` prints: a line for every peak of every sensor, and what cannot be told."""

import numpy as np

from tg4mm.capture.codec import Loss, before_compression
from tg4mm.core.digits import aligned, value_with_deviation
from tg4mm.core.lines import FEWEST, Line
from tg4mm.show.measure.measurement import Measurement, unit_of
from tg4mm.show.measure.orbit import Orbit, main_is_above
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.spectrum import Peak

_WHOLE = 0.9  # of an amplitude that compression let through: less is said
_NO_NOISE_PX = 1e-5  # of a floor: no sensor is so free of noise
HEAD = "sensor", "frequency, Hz", "amplitude", "in pixels", "direction", "phase, deg", "damping", ""


def format_table(measurement: Measurement) -> str:
    """A table, amplitudes zero to peak along each orbit's main axis; phases against the reference sensor."""
    reference = f"phases against {measurement.reference}, where its peaks are; amplitudes zero to peak"
    return (
        "\n".join(
            [*aligned(table_of(measurement)), "", reference, *(f"note: {note}" for note in measurement.notes)]
        )
        + "\n"
    )


def table_of(measurement: Measurement) -> list[list[str]]:
    """Rows of texts, the first of them the head; pixels in a column of their own where amplitudes are not in pixels."""
    rows = [list(HEAD), *(row for result in measurement.sensors for row in rows_of(measurement, result))]
    if unit_of(measurement).name != "px":
        return rows
    return [[cell for k, cell in enumerate(row) if HEAD[k] != "in pixels"] for row in rows]


def rows_of(measurement: Measurement, result: SensorResult) -> list[list[str]]:
    """A row of texts for each peak, as `HEAD` names them; one that says so where there is none."""
    unit = unit_of(measurement, result)
    out: list[list[str]] = []
    for k, (peak, orbit) in enumerate(zip(result.spectrum.peaks, result.orbits, strict=True)):
        loss = result.loss_of(k)
        size, error = before_compression(orbit.amplitude, orbit.deviation, loss)
        damping, pixels = result.damping[k], result.pixels(orbit.direction)
        out.append(
            [
                result.name if not out else "",
                value_with_deviation(peak.frequency_hz, peak.frequency_deviation_hz),
                f"{value_with_deviation(size * unit.factor, error * unit.factor)} {unit.name}",
                f"{value_with_deviation(size * pixels, error * pixels)} px",
                direction_text(orbit.direction, result.labels),
                phase_text(measurement, result, peak.frequency_hz),
                ""
                if damping is None
                else f"{value_with_deviation(100 * damping.ratio, 100 * damping.deviation)} %",
                "; ".join(filter(None, [remark(peak, orbit, loss), *_hidden(result, orbit)])),
            ]
        )
    if out:
        return out
    if len(result.times_s) < FEWEST:
        return [[result.name, "", "", "", "", "", "", f"fewer than {FEWEST} frames: no spectrum"]]
    floor = result.spectrum.typical_floor
    level = float(np.min(floor[np.isfinite(floor)], initial=np.inf))
    if level * result.px_per_unit < _NO_NOISE_PX:
        why = "the pictures hold no noise (compression removed it, or the pictures are rendered): no noise floor"
        return [[result.name, "none", "", "", "", "", "", why]]
    told = f"under {level * unit.factor:.2g} {unit.name}"
    told += "" if unit.name == "px" else f", {level * result.px_per_unit:.2g} px"
    return [[result.name, "none", told, "", "", "", "", "nothing above the noise floor"]]


def _hidden(result: SensorResult, orbit: Orbit) -> list[str]:
    """What is not told beside the main axis."""
    out = []
    for other in orbit.hidden:
        pixels = result.pixels(other.direction)
        size = value_with_deviation(other.amplitude * pixels, other.deviation * pixels)
        out.append(f"not determined along {direction_text(other.direction, result.labels)}: {size} px")
    return out


def remark(peak: Peak, orbit: Orbit, loss: Loss | None = None) -> str:
    """What makes a peak doubtful, or its amplitude."""
    doubts = [] if main_is_above(peak, orbit) else ["not above twice its deviation"]
    doubts += [] if peak.line is None else _changes(peak.line)
    if (tone := peak.asked) is not None:
        doubts.append(f"given band, {tone.band[0]:g} to {tone.band[1]:g} Hz: {tone.periods:.2g} periods")
    if loss is not None and (loss.why or loss.gain < _WHOLE):
        doubts.append(
            loss.why or f"corrected: compression let {loss.gain:.2f} ± {loss.deviation:.2f} of it through"
        )
    return "; ".join(
        [*doubts, *(str(other) for other in (peak.harmonic, peak.sideband) if other is not None)]
    )


def _changes(line: Line) -> list[str]:
    """What a test says of a line's strength over the record."""
    if line.change == "begins":
        return [f"begins at {line.start_s:.3g} s"]
    return {"decays": ["rings down"], "grows": ["grows"], "varies": ["varies"]}.get(line.change, [])


def direction_text(direction: np.ndarray, labels: tuple[str, ...]) -> str:
    """The main direction, for instance `+0.97 x  −0.24 z`: what is under a twentieth is left out."""
    parts = [
        f"{'+' if d > 0 else '−'}{abs(d):.2f} {label}"
        for d, label in zip(direction, labels, strict=True)
        if abs(d) >= 0.05
    ]
    return " ".join(parts)


def phase_text(measurement: Measurement, result: SensorResult, frequency_hz: float) -> str:
    """Against the reference at that frequency, if it is one of its peaks."""
    if result.name == measurement.reference:
        return "reference"
    if result.relation is None:
        return ""
    resolution = 1 / measurement.prepared.observations.duration_s
    for at in result.relation.phases:
        if abs(at.frequency_hz - frequency_hz) < resolution / 2 and at.is_above:
            return f"{np.degrees(at.phase):+.1f} ± {np.degrees(at.deviation):.1f}"
    return ""
