"""The printed table of `tg4mm measure`: a line for every peak of every sensor, and the notes."""

import numpy as np

from tg4mm.capture.codec import Loss, before_compression
from tg4mm.core.digits import aligned, value_with_deviation
from tg4mm.core.lines import FEWEST
from tg4mm.show.measure.measurement import Measurement, unit_of
from tg4mm.show.measure.orbit import Orbit, main_is_above
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.spectrum import Peak

_COMPLETE = 0.9  # of an amplitude: if compression let less through, a remark says so
_NO_NOISE_PX = 1e-5  # of a floor: no sensor is so free of noise
HEAD = "sensor", "frequency, Hz", "amplitude", "in pixels", "direction", "phase, deg", "damping", ""


def format_table(measurement: Measurement) -> str:
    """Return the table and notes as text; amplitudes are zero to peak along each orbit's main axis."""
    reference = f"phases against {measurement.reference}, where its peaks are; amplitudes zero to peak"
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
        out.append(
            [
                result.name if not out else "",
                value_with_deviation(peak.frequency_hz, peak.frequency_deviation_hz),
                f"{value_with_deviation(size * unit.factor, error * unit.factor)} {unit.name}",
                f"{value_with_deviation(size * pixels, error * pixels)} px",
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
    if (line := peak.line) is not None:
        changes = {"begins": f"begins at {line.start_s or 0.0:.3g} s", "decays": "rings down"}
        changes |= {"grows": "grows", "varies": "varies"}
        out += [changes[line.change]] if line.change in changes else []
    if (tone := peak.asked) is not None:
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
