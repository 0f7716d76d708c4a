"""A measurement: every sensor's displacement over time and what follows from it, the scene's clusters and shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tg4mm.measure.clusters import Clusters, clusters_of
from tg4mm.measure.damping import Damping, damping_of
from tg4mm.measure.derivatives import Derivatives, derivatives_of
from tg4mm.measure.errors import MeasureError
from tg4mm.measure.limits import limits_of
from tg4mm.measure.locate import body_of, weights_of
from tg4mm.measure.model_error import with_model_error
from tg4mm.measure.orbit import Orbit, orbit_of
from tg4mm.measure.prepared import Clock, Prepared, prepare
from tg4mm.measure.relations import Relation, relation_of
from tg4mm.measure.rigid import Body, equations_of
from tg4mm.measure.sensors import Sensor, checked_names
from tg4mm.measure.series import Series, series_of
from tg4mm.measure.shapes import Shape, shapes_of
from tg4mm.measure.spectrum import Peak, Spectrum, spectrum_of
from tg4mm.progress import progress
from tg4mm.runs import Run


@dataclass(frozen=True)
class SensorResult:
    """One sensor. Where every clip has a clock of its own, the first clip's series; all of them are in `clips`.

    Arrays are in scene units along `axes`; a direction that is not observed has the deviation inf and the value 0.
    """

    sensor: Sensor
    body: Body
    series: Series
    px_per_unit: float  # pixels per scene unit at the region, in the view that sees it largest
    best_view: str
    clips: tuple[Series, ...] = ()
    relation: Relation | None = None  # to the reference sensor; None for that sensor itself, and of clips

    @property
    def name(self) -> str:
        return self.sensor.name

    @property
    def times_s(self) -> np.ndarray:
        """[T]"""
        return self.series.times_s

    @property
    def displacement(self) -> np.ndarray:
        """[T, 3] scene units, about the mean over the record."""
        return self.series.displacement

    @property
    def deviation(self) -> np.ndarray:
        """[T, 3] standard deviation of each sample, scene units."""
        return self.series.deviation

    @property
    def axes(self) -> np.ndarray:
        """[3, 3], rows: unit vectors in the world."""
        return self.series.axes

    @property
    def labels(self) -> tuple[str, str, str]:
        """Of the axes: x, y, z, or right, up, sight of one fixed camera."""
        return self.series.labels

    @cached_property
    def spectrum(self) -> Spectrum:
        return spectrum_of(self.times_s, self.displacement, self.series.noise, self.series.model_share)

    @cached_property
    def derivatives(self) -> Derivatives:
        return derivatives_of(self.times_s, self.displacement, self.series.noise, self.spectrum.peaks)

    @property
    def velocity(self) -> np.ndarray:
        """[T, 3] scene units / s."""
        return self.derivatives.velocity

    @property
    def acceleration(self) -> np.ndarray:
        """[T, 3] scene units / s²."""
        return self.derivatives.acceleration

    @cached_property
    def orbits(self) -> tuple[Orbit, ...]:
        """The ellipse of each peak."""
        return tuple(orbit_of(peak) for peak in self.spectrum.peaks)

    @cached_property
    def damping(self) -> tuple[Damping | None, ...]:
        """Of each peak; None where it does not ring down by more than its deviation."""
        return tuple(damping_of(self.series, self.spectrum.peaks, k) for k in range(len(self.spectrum.peaks)))


@dataclass(frozen=True)
class Measurement:
    """Everything that was measured in one call: `sensors`, also by name as `found["tip"]`."""

    prepared: Prepared
    sensors: tuple[SensorResult, ...]
    clusters: Clusters
    shapes: tuple[
        Shape, ...
    ]  # operating deflection shapes, one for each frequency that sensors or modes show
    reference: str  # name of the sensor that phases are against
    notes: tuple[str, ...] = field(default=())  # what this capture cannot tell, and what is under the floor

    @property
    def unit_scale_m(self) -> float | None:
        """Metres per scene unit; None if unknown, and of a flat capture, whose unit is the pixel's."""
        return None if self.prepared.capture.kind == "flat" else self.prepared.capture.unit_scale_m

    def __getitem__(self, name: str) -> SensorResult:
        for result in self.sensors:
            if result.name == name:
                return result
        raise KeyError(name)


def measure(
    run: Run | Prepared,
    sensors: Sequence[Sensor] | None = None,
    reference: str | None = None,
    clusters: Clusters | None = None,
) -> Measurement:
    """Measure sensors on a run; without any, clusters that move alike and the whole scene.

    run: a `Prepared` (`prepare(run)`) skips reading the pictures, which makes a further sensor a matter of one product
    with the Jacobian of every view; `clusters` of an earlier measurement are found by `Measurement.clusters`.
    reference: the sensor that phases and coherence are against; by default the first.
    Raises MeasureError for a sensor that holds nothing, that no picture shows, or a reference that is none of them.
    """
    scene = run if isinstance(run, Prepared) else prepare(run)
    groups = clusters or clusters_of(scene)
    wanted = checked_names(sensors if sensors is not None else default_sensors(groups))
    if not wanted:
        raise MeasureError("no sensor was named")
    if reference is not None and reference not in [s.name for s in wanted]:
        raise MeasureError(
            f"reference {reference!r} is no sensor; there are: {', '.join(s.name for s in wanted)}"
        )
    bodies = [body_of(weights_of(s, scene, groups.members), scene) for s in wanted]
    with progress("sensors", len(scene.clocks), "clocks") if _is_long(scene, wanted) else _silent() as update:
        series = [_series(scene, clock, bodies, update, k) for k, clock in enumerate(scene.clocks)]
    results = [
        _result(scene, s, body, [own[b] for own in series])
        for b, (s, (body, _)) in enumerate(zip(wanted, bodies, strict=True))
    ]
    first = reference or wanted[0].name
    against = next(r for r in results if r.name == first)
    results = [r if r is against else _related(r, against) for r in results]
    shapes = shapes_of(scene, results)
    notes = limits_of(scene, results)
    return Measurement(scene, tuple(results), groups, shapes, first, notes)


def default_sensors(clusters: Clusters) -> list[Sensor]:
    """Every cluster that moves alike, what stands still, and the whole scene."""
    out = [Sensor(name, "cluster", (float(k),)) for k, name in clusters.names.items()]
    return [*out, Sensor("all", "all")]


def best_peak(result: SensorResult) -> Peak | None:
    """The strongest peak over its floor; None where there is none."""
    return result.spectrum.peaks[0] if result.spectrum.peaks else None


def _series(scene: Prepared, clock: Clock, bodies: Sequence, update, k: int) -> list[Series]:
    views = scene.views if scene.is_moving else [scene.views[v] for v in clock.views]
    own = [body for body, _ in bodies]
    equations = equations_of(
        own, scene.means, views, clock.sides, scene.modal.fields, clock.series, scene.is_moving
    )
    update(k + 1)
    return [
        with_model_error(
            series_of(e, clock.times_s, body.axes, labels, body.radius, clock.name, scene.slow), body, scene
        )
        for e, (body, labels) in zip(equations, bodies, strict=True)
    ]


def _result(scene: Prepared, sensor: Sensor, body: Body, series: Sequence[Series]) -> SensorResult:
    frames = scene.observations.frames
    scales = [_px_per_unit(f, body.centre) for f in frames]
    best = int(np.argmax(scales))
    clips = tuple(series) if len(series) > 1 else ()
    return SensorResult(sensor, body, series[0], scales[best], frames[best].name, clips)


def _px_per_unit(frames, centre: np.ndarray) -> float:
    depth = float(frames.viewmat[2, :3] @ centre + frames.viewmat[2, 3])
    return float(frames.K[0, 0]) / depth if depth > 0 else 0.0


def _related(result: SensorResult, against: SensorResult) -> SensorResult:
    from dataclasses import replace

    return replace(result, relation=relation_of(result, against))


def _is_long(scene: Prepared, sensors: Sequence[Sensor]) -> bool:
    width, height = scene.observations.size
    return len(scene.views) * len(sensors) * width * height > 5e6


class _silent:
    def __enter__(self):
        return lambda done, **figures: None

    def __exit__(self, *error: object) -> None:
        return None
