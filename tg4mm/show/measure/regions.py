"""Sensors on the regions of a flat capture that vibrate, as the look at it found them."""

import numpy as np

from tg4mm.capture.look import Found
from tg4mm.run import Run
from tg4mm.run.stages.look import look_of
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensors import Sensor


def found_in(scene: Prepared) -> Found | None:
    """What the look found; None of other captures than flat ones, and of fits without a run."""
    if scene.capture.kind.sees_depth or scene.folder is None:
        return None
    return look_of(Run.open(scene.folder))


def region_sensors(scene: Prepared, found: Found) -> list[Sensor]:
    """A disc as large as each vibration's region at the region's centre."""
    camera = scene.observations.frames[0].name
    out: list[Sensor] = []
    for line in found.vibrations:
        radius = found.cell_px * float(np.sqrt(line.region.sum() / np.pi))
        name = f"{line.hz:.4g} Hz"
        if name not in [sensor.name for sensor in out]:
            out.append(Sensor(name, "pixel", (*line.centre_px, radius), camera))
    return out
