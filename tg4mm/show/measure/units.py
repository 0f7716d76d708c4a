"""Lengths as they are printed: mm where the scale is known, else pixels of a flat capture, else scene units."""

from dataclasses import dataclass

from tg4mm.show.measure.measurement import Measurement
from tg4mm.show.measure.sensor_result import SensorResult


@dataclass(frozen=True)
class Unit:
    """What scene units are multiplied by, and what that is called."""

    name: str  # in text: mm, units, px
    column: str  # in a column's name: mm, scene_units, px
    factor: float
    uff: tuple[int, float, str]  # code of dataset 164 (1: metres), metres per stored unit, text of the units


def unit_of(measurement: Measurement, result: SensorResult | None = None) -> Unit:
    """Return the unit of a measurement; of a flat capture at one sensor (its depth is the picture's own)."""
    if (scale := measurement.unit_scale_m) is not None:
        return Unit("mm", "mm", 1000 * scale, (1, scale, "metres"))
    if not measurement.prepared.capture.kind.sees_depth:
        some = result or measurement.sensors[0]
        return Unit("px", "px", some.px_per_unit, (9, 1.0, "pixels"))
    return Unit("units", "scene_units", 1.0, (9, 1.0, "scene units"))
