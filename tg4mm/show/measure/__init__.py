"""Virtual sensors: displacement of regions over time from the pictures, with deviations, spectra and shapes.

    scene = prepare(Run.open("runs/mic"))                     # reads the pictures once; cached in the run's folder
    found = measure(scene, [parse_sensor("tip=sphere:0,0,1.2,0.1")])
    tip = found["tip"]
    tip.times_s, tip.displacement, tip.deviation              # [T], [T, 3], [T, 3] scene units along tip.axes
    tip.spectrum.freqs_hz, .amplitude, .floor, .peaks         # [F], [F, 3], [F, 3], Peak each

docs/measure.md has the equations.
"""

from tg4mm.show.measure.clusters import Clusters
from tg4mm.show.measure.measurement import Measurement, default_sensors, measure, measure_one
from tg4mm.show.measure.prepared import prepare, prepare_fit
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.sensors import MeasureError, Sensor, parse_sensor, read_sensors
from tg4mm.show.measure.series import Series
from tg4mm.show.measure.shapes import OperatingShape
from tg4mm.show.measure.spectrum import Peak, Spectrum
from tg4mm.show.measure.tables import sep005
from tg4mm.show.measure.video import prepare_video

__all__ = [
    "Clusters",
    "MeasureError",
    "Measurement",
    "OperatingShape",
    "Peak",
    "Prepared",
    "Sensor",
    "SensorResult",
    "Series",
    "Spectrum",
    "default_sensors",
    "measure",
    "measure_one",
    "parse_sensor",
    "prepare",
    "prepare_fit",
    "prepare_video",
    "read_sensors",
    "sep005",
]
