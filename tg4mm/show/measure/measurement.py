"""A measurement: displacement over time of every sensor and quantities derived from it; clusters and shapes."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from tg4mm.capture.codec import coded_change
from tg4mm.capture.look import LookSummary
from tg4mm.core.lines import CodecChange
from tg4mm.core.magnification import check_band
from tg4mm.core.progress import progress
from tg4mm.core.regions import Scale
from tg4mm.fit.motion.config import asked_band
from tg4mm.fit.motion.observations import check_band_resolved
from tg4mm.run import Run
from tg4mm.show.measure.clips import ClipPhases, KnownPhases, Together, together
from tg4mm.show.measure.clusters import Clusters, clusters_of
from tg4mm.show.measure.flat import FlatSensor, flat_sensors
from tg4mm.show.measure.limits import limits_of, with_losses
from tg4mm.show.measure.locate import (
    OF_ONE_CAMERA,
    body_of,
    check_sensors,
    px_per_unit,
    sight_axes,
    unit_scale,
    weights_of,
)
from tg4mm.show.measure.prepared import prepare
from tg4mm.show.measure.residuals import MeasuredView
from tg4mm.show.measure.rigid import RigidBody, equations_of
from tg4mm.show.measure.scene import GreyPictures, Prepared, SharedClock, clock_phases
from tg4mm.show.measure.sensor_result import SensorResult, relation_of
from tg4mm.show.measure.sensors import MeasureError, Sensor, checked_names
from tg4mm.show.measure.series import Series, series_of, shared_error, with_model_error
from tg4mm.show.measure.shapes import OperatingShape, shapes_of
from tg4mm.show.measure.spectrum import USUAL_PERIOD
from tg4mm.show.measure.stored_pass import HALVES
from tg4mm.show.measure.video import looked_at

_LONG = 5e5  # pixels times views and sensors beyond which progress is shown


@dataclass(frozen=True)
class Measurement:
    """The results of one call: `sensors`, also by name as `found["tip"]`."""

    prepared: Prepared  # what was measured
    sensors: tuple[SensorResult, ...]  # in the order requested
    clusters: Clusters  # groups of Gaussians that move alike
    shapes: tuple[
        OperatingShape, ...
    ]  # operating deflection shapes, one for each frequency of the sensors' peaks
    reference: str  # name of the sensor that phases refer to
    notes: tuple[str, ...] = ()  # limits of this capture, and sensors without a significant peak
    clip_phases: ClipPhases | None = None  # if cameras have independent clocks
    look: LookSummary | None = None  # result of the look at one fixed camera's regions
    marked_scale_m: float | None = None  # metres per scene unit by the marks in the picture

    @property
    def unit_scale_m(self) -> float | None:
        """Metres per scene unit; None if unknown, and of a flat capture without a marked scale."""
        if self.marked_scale_m is not None:
            return self.marked_scale_m
        return self.prepared.capture.unit_scale_m if self.prepared.capture.kind.sees_depth else None

    def __getitem__(self, name: str) -> SensorResult:
        for result in self.sensors:
            if result.name == name:
                return result
        raise KeyError(f"no sensor {name!r}; there are: {', '.join(s.name for s in self.sensors)}")


def measure(
    run: Run | Prepared,
    sensors: Sequence[Sensor] | None = None,
    reference: str | None = None,
    clusters: Clusters | None = None,
    band: tuple[float, float] | None = None,
    scale: Scale | None = None,
) -> Measurement:
    """Measure the displacement of virtual sensors over time, in the pictures (docs/measure.md).

    Args:
        run: a run, or what `prepare` or `prepare_fit` returned, which needs no pictures for further sensors.
        sensors: regions to measure; `None`: clusters that move alike, the whole scene, and the regions that vibrate
            before one fixed camera; of a flat capture these in place of clusters.
        reference: name of the sensor that phases and coherence refer to; `None`: the first.
        clusters: `Measurement.clusters` of an earlier call; `None` finds them.
        band: (low, high) in Hz: every sensor gets a peak there, significant or not; its ± includes the uncertainty of
            a short record. `None`: that of the run's training, if it was given one. Not for clips.
        scale: marked in the one camera's picture; with a rectangle, a flat capture's right and up are its plane's.

    Returns:
        A waveform with its deviation, a spectrum with its noise floor, and peaks for each sensor, in scene units.

    Raises:
        MeasureError: a sensor contains no Gaussian, no picture shows it, or `reference` is not a sensor.
        CaptureError: the band does not fit the record.
    """
    if isinstance(run, Run):
        check_sensors(run, sensors or ())
    scene = run if isinstance(run, Prepared) else prepare(run)
    metres = None if scale is None else unit_scale(scale, scene)
    scene = replace(scene, scale=scale)
    has_gaussians = len(scene.means) > 0
    groups = clusters or (clusters_of(scene) if has_gaussians else Clusters({}, {}))
    found = looked_at(scene) if sensors is None and not has_gaussians else scene.found
    regions = region_sensors(scene, found) if found is not None and sensors is None else []
    regions, lost = _on_surfaces(regions, scene) if scene.capture.kind.sees_depth else (regions, [])
    if scene.capture.kind.sees_depth or not regions:
        defaults = [*default_sensors(groups), *regions]
    else:
        defaults = [*regions, Sensor("all", "all")]
    wanted = checked_names(sensors if sensors is not None else defaults)
    if not wanted:
        raise MeasureError("no sensor was named")
    names = [s.name for s in wanted]
    if reference is not None and reference not in names:
        raise MeasureError(f"reference {reference!r} is not a sensor; sensors: {', '.join(names)}")
    results, phases = _results(scene, wanted, groups.members)
    observations = scene.observations
    asked = band or asked_band(scene.fit.config.band, observations.fps)
    if asked is not None:
        check_band_resolved(check_band(asked, observations.fps), observations.duration_s)
        results = [r.with_(band=asked) for r in results]
    results = with_losses(scene, results)
    first = reference or names[0]
    against = results[names.index(first)]
    results = [r if r is against else r.with_(relation=relation_of(r, against)) for r in results]
    notes = (*limits_of(scene, results), *lost)
    if scale is not None:
        notes = (*notes, f"the scale is known to {100 * scale.share:.2g} % by its marks, which no ± includes")
    shapes = shapes_of(scene, results)
    return Measurement(scene, tuple(results), groups, shapes, first, notes, phases, found, metres)


def measure_one(scene: Prepared, sensor: Sensor) -> SensorResult:
    """Measure one sensor quickly, without clusters, shapes and notes.

    Raises MeasureError as `measure` does, and for a cluster, since none are computed.
    """
    return _results(scene, [sensor], {})[0][0]


def default_sensors(clusters: Clusters) -> list[Sensor]:
    """Return a sensor for every cluster, the static one included, and one for the complete scene."""
    out = [Sensor(name, "cluster", (float(k),)) for k, name in clusters.names.items()]
    return [*out, Sensor("all", "all")]


def _results(
    scene: Prepared, wanted: Sequence[Sensor], clusters: Mapping[int, np.ndarray]
) -> tuple[list[SensorResult], ClipPhases | None]:
    """Return the result of every sensor, without its relation to a reference."""
    if not scene.capture.kind.sees_depth:
        return _flat_results(scene, wanted, clusters), None
    bodies = [body_of(weights_of(s, scene, clusters), scene) for s in wanted]
    views = [scene.views if scene.is_moving else [scene.views[v] for v in c.views] for c in scene.clocks]
    of_fixed = (len(v.halves) for own in views for v in own)
    halves = (
        HALVES * len(scene.views) if scene.is_moving else sum(of_fixed)
    )  # a moving camera's are made on demand
    width, height = scene.observations.size
    is_long = len(scene.views) * len(wanted) * width * height > _LONG
    shown = progress("sensors", halves * len(bodies), "steps") if is_long else nullcontext(lambda done: None)
    with shown as update:
        done = count(1)
        series = [
            _series(scene, clock, own, bodies, lambda: update(next(done)))
            for clock, own in zip(scene.clocks, views, strict=True)
        ]
    clips: Sequence[Together | None] = [None] * len(wanted)
    phases = None
    if len(scene.clocks) > 1:
        clips, phases = _of_clips(scene, series, bodies)
    results = [
        _result(scene, s, body, [own[b] for own in series], clips[b])
        for b, (s, (body, _)) in enumerate(zip(wanted, bodies, strict=True))
    ]
    return results, phases


def _flat_results(
    scene: Prepared, wanted: Sequence[Sensor], clusters: Mapping[int, np.ndarray]
) -> list[SensorResult]:
    with progress("sensors", len(wanted), "sensors", brief=True) as update:
        done = count(1)
        found = flat_sensors(scene, wanted, clusters, lambda: update(next(done)))
    pictures, out = scene.observations.pictures, []
    for sensor, own in zip(wanted, found, strict=True):
        result = _result(scene, sensor, own.body, [own.series], None)
        if isinstance(pictures, GreyPictures):
            result = replace(result, codec=_codec_change(own, pictures.kinds, result.px_per_unit))
        out.append(replace(result, mask=own.mask, motion=own.motion, spread=own.spread))
    return out


def _codec_change(own: FlatSensor, kinds: np.ndarray, px_per_unit: float) -> CodecChange:
    """Return what compression may change a line of a region by, for motion across its weakest texture."""
    found = coded_change(own.motion.misfit, kinds)
    slope = np.linalg.eigvalsh(own.motion.normals.sum(0)[:2, :2])[0] / float(own.mask.sum())
    return replace(found, size=found.size * np.sqrt(2 / max(slope, 1e-12)) / px_per_unit)


def _series(
    scene: Prepared,
    clock: SharedClock,
    views: Sequence[MeasuredView],
    bodies: Sequence,
    step: Callable[[], None],
) -> list[Series]:
    assert clock.right_hand_sides is not None
    equations = equations_of([body for body, _ in bodies], scene, clock, views, step)
    out = []
    for e, (body, labels) in zip(equations, bodies, strict=True):
        axes = body.axes
        if len(scene.clocks) > 1:
            viewmat = views[0].frames.viewmat.astype(np.float64)
            axes, labels = sight_axes(viewmat, body.centre), OF_ONE_CAMERA
            e = e.along(axes)
        series = series_of(e, clock.times_s, axes, labels, body.radius, clock.name, scene.slow)
        out.append(with_model_error(series, body, scene))
    return out


def _of_clips(
    scene: Prepared, series: Sequence[Sequence[Series]], bodies: Sequence
) -> tuple[list[Together], ClipPhases]:
    freqs_hz, figures = scene.modal.freqs_hz, scene.fit.figures
    phases = [clock_phases(figures, c.name, freqs_hz) for c in scene.clocks]
    known = [p for p in phases if p is not None]
    radians = np.array(known) if len(known) == len(phases) else np.zeros((len(phases), 0))
    hz = freqs_hz if radians.shape[1] else np.zeros(0)
    shared = [shared_error(scene, body) for body, _ in bodies]
    return together([list(own) for own in zip(*series, strict=True)], KnownPhases(hz, radians), shared)


def _result(
    scene: Prepared, sensor: Sensor, body: RigidBody, series: Sequence[Series], clips: Together | None
) -> SensorResult:
    frames = scene.observations.frames
    scales = [px_per_unit(f, body.centre) for f in frames]
    best = int(np.argmax(scales))
    b_frames = scene.b_frames if len(series) == 1 else None
    period = scene.observations.codec_period or (None if scene.video is None else USUAL_PERIOD)
    codec = None if scene.found is None else CodecChange(scene.found.coded_change)
    return SensorResult(
        sensor, body, tuple(series), scales[best], frames[best].name, clips, period, b_frames, codec
    )


def region_sensors(scene: Prepared, found: LookSummary) -> list[Sensor]:
    """Return a disc as large as each vibration's region, at the region's centre."""
    camera = scene.observations.frames[0].name
    out: list[Sensor] = []
    for line in found.vibrations:
        radius = found.cell_px * float(np.sqrt(line.region.sum() / np.pi))
        name, taken = f"{line.hz:.4g} Hz", [sensor.name for sensor in out]
        if name in taken:  # another part at this frequency
            name += f" {1 + sum(other.startswith(name) for other in taken)}"
        out.append(Sensor(name, "pixel", (*line.centre_px, radius), camera))
    return out


def _on_surfaces(regions: Sequence[Sensor], scene: Prepared) -> tuple[list[Sensor], list[str]]:
    """Return the regions that show Gaussians, and a note for each other."""
    there: list[Sensor] = []
    lost: list[str] = []
    for region in regions:
        try:
            weights_of(region, scene, {})
            there.append(region)
        except MeasureError as error:
            lost.append(f"the vibration at {region.name} of `tg4mm look` is not measured in 3D: {error}")
    return there, lost


@dataclass(frozen=True)
class MeasurementUnit:
    """A unit of length: its names, and its number per scene unit."""

    name: str  # in text: mm, units, px
    column: str  # in a column's name: mm, scene_units, px
    factor: float
    uff: tuple[int, float, str]  # code of dataset 164 (1: metres), metres per stored unit, text of the units


def unit_of(measurement: Measurement, result: SensorResult | None = None) -> MeasurementUnit:
    """Return the unit of a measurement; for a flat capture that at one sensor."""
    if (scale := measurement.unit_scale_m) is not None:
        return MeasurementUnit("mm", "mm", 1000 * scale, (1, scale, "metres"))
    if not measurement.prepared.capture.kind.sees_depth:
        some = result or measurement.sensors[0]
        return MeasurementUnit("px", "px", some.px_per_unit, (9, 1.0, "pixels"))
    return MeasurementUnit("units", "scene_units", 1.0, (9, 1.0, "scene units"))
