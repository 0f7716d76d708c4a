"""Result of one sensor: displacement over time on every clock, peaks, and its motion relative to another sensor."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import csd, welch

from tg4mm.capture.codec import Loss
from tg4mm.capture.tracking.region import RegionMotion
from tg4mm.core.even_clock import is_filled, on_even_clock
from tg4mm.core.lines import CodecChange, Line, fit_lines
from tg4mm.core.lines.band import BandLine, tone_in
from tg4mm.show.measure.clips import Together
from tg4mm.show.measure.damping import Damping, damping_of, with_loss
from tg4mm.show.measure.rigid import RigidBody
from tg4mm.show.measure.sensors import Sensor
from tg4mm.show.measure.series import Derivatives, Series, derivatives_of, deviations_of
from tg4mm.show.measure.spectrum import (
    Orbit,
    Peak,
    Spectrum,
    orbit_in,
    orbit_of,
    spectrum_of,
    strength_of,
    with_band,
    with_sidebands,
)

WORLD = "x", "y", "z"
_SEGMENTS = 4  # of a record, half overlapping
_SHORTEST = 16  # samples of a segment


@dataclass(frozen=True)
class PhaseAt:
    """The phase at one of the reference's peaks, of motion along each sensor's main direction."""

    frequency_hz: float
    amplitude: float  # of this sensor, scene units
    phase: float  # radians, this sensor's less the reference's, −π … π
    deviation: float  # radians; π: unknown
    is_above: bool  # whether this sensor exceeds its floor there


@dataclass(frozen=True)
class Relation:
    """The motion relative to the sensor `reference`."""

    reference: str
    phases: tuple[PhaseAt, ...]
    freqs_hz: np.ndarray  # [F] of the coherence; empty where the record is too short
    coherence: np.ndarray  # [F] magnitude squared, of the main directions, Welch
    segments: int
    chance: float  # coherence that noise alone stays under in 95 of 100: 1 − 0.05^(1 / (segments − 1))


@dataclass(frozen=True)
class SensorRecord:
    """A sensor's series on one clock, and its peaks' phasors along the series' axes and on that clock."""

    series: Series
    peaks: tuple[Peak, ...]

    @cached_property
    def derivatives(self) -> Derivatives:
        own = self.series
        return derivatives_of(own.times_s, own.displacement, self.peaks)

    @cached_property
    def derivative_deviations(self) -> Derivatives:
        """Standard deviations of `derivatives`; inf along a direction that is not observed."""
        own = self.series
        return deviations_of(self.derivatives, own.times_s, own.noise, own.model_share, self.peaks)


@dataclass(frozen=True)
class SensorResult:
    """The result of one sensor, in scene units; a direction that is not observed has deviation inf and value 0.

    If the cameras have independent clocks, spectrum, peaks and orbits combine all clips, along the world's x, y, z
    (`axes`, `labels`). A waveform belongs to one clip, along its camera's axes: `records` has all of them; `series`,
    `times_s`, `displacement`, `deviation`, `velocity` and `acceleration` are the first clip's, along `series.axes`.
    """

    sensor: Sensor  # as requested
    body: RigidBody  # the Gaussians of the region and their weights
    all_series: tuple[Series, ...]  # one for each clock
    px_per_unit: float  # pixels per scene unit at the region, in the view that sees it largest
    best_view: str  # name of that view
    together: Together | None = None  # of clips
    codec_period: int | None = None  # frames, of the video's compression
    b_frames: np.ndarray | None = None  # [T] bool: frames that the codec predicts from both sides
    codec: CodecChange | None = None  # what compression may change a steady line by
    losses: tuple[Loss, ...] = ()  # for every peak, the part that compression let through; () if not tested
    band: tuple[float, float] | None = None  # Hz, requested: it gets a peak, significant or not
    relation: Relation | None = None  # to the reference sensor; None for that sensor itself
    mask: np.ndarray | None = None  # [H, W] weights of the region's pixels, for a flat capture
    motion: RegionMotion | None = None  # measured motion of the region, for a flat capture
    spread: float = 0.0  # rms difference of its parts' motion from its own, over that, for a flat capture

    @property
    def name(self) -> str:
        """The sensor's name."""
        return self.sensor.name

    @property
    def extent(self) -> str:
        """The number of Gaussians, or of pixels in a flat capture."""
        weights, what = (self.body.weights, "Gaussians") if self.mask is None else (self.mask, "pixels")
        return f"{int((weights > 0).sum()):,} {what}"

    def with_(self, **changes: Any) -> "SensorResult":
        """Replace fields that the spectrum does not depend on, and keep the computed spectrum."""
        out = replace(self, **changes)
        if "spectrum" in self.__dict__:
            out.__dict__["spectrum"] = self.spectrum
        return out

    def loss_of(self, k: int) -> Loss | None:
        """Return which part of peak k the video's compression let through; None if not tested."""
        return self.losses[k] if self.losses else None

    @property
    def series(self) -> Series:
        """The series of the only clock, or the first."""
        return self.all_series[0]

    @property
    def clips(self) -> tuple[Series, ...]:
        """The series of every clip; () if all cameras share one clock."""
        return self.all_series if self.together is not None else ()

    @property
    def times_s(self) -> np.ndarray:
        """Return [T] seconds."""
        return self.series.times_s

    @property
    def displacement(self) -> np.ndarray:
        """Return [T, A] scene units, about the mean over the record."""
        return self.series.displacement

    @property
    def deviation(self) -> np.ndarray:
        """Return [T, A] standard deviation of each sample, scene units."""
        return self.series.deviation

    @property
    def axes(self) -> np.ndarray:
        """Return [A, 3], rows: unit vectors in the world, of the spectrum and the peaks."""
        return self.series.axes if self.together is None else np.eye(3)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the axes: x, y, z; right, up, sight for one fixed camera; right, up for a flat capture."""
        return self.series.labels if self.together is None else WORLD

    def pixels(self, along: np.ndarray) -> float:
        """Return the pixels of a motion by one scene unit along a direction [A] in the axes."""
        if len(self.labels) != 2:  # turned away from the camera it would be fewer
            return self.px_per_unit
        return self.px_per_unit * float(np.linalg.norm(along @ self.axes))

    @cached_property
    def spectrum(self) -> Spectrum:
        """Amplitude and noise floor over frequency, scene units and Hz, and the peaks."""
        if self.together is not None:
            found = self.together.spectrum
        else:
            own = self.series
            seen = ~self.motion.hidden if self.motion is not None else np.ones(len(own.times_s), bool)
            values = own.times_s[seen], own.displacement[seen], own.noise[seen], own.model_share
            b_frames = None if self.b_frames is None else self.b_frames[seen]
            found = spectrum_of(*values, b_frames, self.codec)
            if self.band is not None:
                found = with_band(found, self.band, *values)
            found = replace(found, peaks=tuple(replace(p, correlation=own.correlation) for p in found.peaks))
        longest = max((s.times_s for s in self.all_series), key=len)
        fps, duration = 1 / float(np.median(np.diff(longest))), float(np.ptp(longest))
        return replace(found, peaks=with_sidebands(found.peaks, self.codec_period, fps, duration))

    @cached_property
    def records(self) -> tuple[SensorRecord, ...]:
        """The series and peaks on every clock."""
        own = (self.spectrum.peaks,) if self.together is None else self.together.of_clips
        return tuple(SensorRecord(series, peaks) for series, peaks in zip(self.all_series, own, strict=True))

    @property
    def velocity(self) -> np.ndarray:
        """Return [T, A] scene units / s."""
        return self.records[0].derivatives.velocity

    @property
    def acceleration(self) -> np.ndarray:
        """Return [T, A] scene units / s²."""
        return self.records[0].derivatives.acceleration

    @cached_property
    def orbits(self) -> tuple[Orbit, ...]:
        """The ellipse of each peak."""
        return tuple(orbit_of(peak) for peak in self.spectrum.peaks)

    @cached_property
    def damping(self) -> tuple[Damping | None, ...]:
        """The damping of each peak, from the clip in which it is strongest; None where it is unknown."""
        found = []
        for k in range(len(self.spectrum.peaks)):
            record = max(self.records, key=lambda r: strength_of(r.peaks[k]))
            found.append(None if record.peaks[k].requested else damping_of(record.series, record.peaks[k]))
        return tuple(map(with_loss, found, self.losses) if self.losses else found)


def relation_of(result: SensorResult, reference: SensorResult) -> Relation:
    """Compare a sensor with the reference: phases at its peaks, and coherence, which is undefined for clips."""
    phases = []
    for peak, (own, is_above) in zip(reference.spectrum.peaks, _at(result, reference), strict=False):
        orbit = orbit_of(peak)
        phase = float((own.phase - orbit.phase + np.pi) % (2 * np.pi) - np.pi)
        relative, other = (o.deviation / max(o.amplitude, 1e-300) for o in (own, orbit))
        error = float(np.hypot(relative, other))
        phases.append(PhaseAt(peak.frequency_hz, own.amplitude, phase, min(error, np.pi), is_above))
    freqs, coherence, segments = np.zeros(0), np.zeros(0), 0
    if result.together is None:
        freqs, coherence, segments = _coherence(result.series, reference.series)
    chance = 1 - 0.05 ** (1 / (segments - 1)) if segments > 1 else 1.0
    return Relation(reference.name, tuple(phases), freqs, coherence, segments, chance)


def _at(result: SensorResult, reference: SensorResult) -> list[tuple[Orbit, bool]]:
    """Return a sensor's orbit at each of the reference's peaks, and whether it is significant; [] if it is blind."""
    peaks, level = reference.spectrum.peaks, result.spectrum.floor.min(0)
    if (clips := result.together) is not None:
        own = [min(clips.everywhere, key=lambda p: abs(p.frequency_hz - q.frequency_hz)) for q in peaks]
        return [(orbit_of(p), bool((p.amplitude > level)[p.is_resolved].any())) for p in own]
    lines = [p.line for p in peaks if p.line is not None]
    series, resolved, out = result.series, result.series.is_resolved, []
    if not resolved.any():  # such as the complete scene before a moving camera
        return []
    values, known = series.displacement[:, resolved], np.sqrt((series.noise[:, resolved] ** 2).mean(0))
    found: list[Line | BandLine] = [*fit_lines(values, series.times_s, lines).lines] if lines else []
    for p in peaks[len(lines) :]:  # a requested band comes last: at the reference's frequency
        found.append(tone_in(values, series.times_s, (0.999 * p.frequency_hz, 1.001 * p.frequency_hz), known))
    for one in found:
        phasor, error = np.zeros(len(level), complex), np.zeros(len(level))
        phasor[resolved], error[resolved] = one.phasor, one.amplitude_deviation
        is_above = bool((np.abs(phasor) > np.maximum(level, 2 * error)).any())
        out.append((orbit_in(phasor, error, resolved, series.correlation), is_above))
    return out


def _coherence(a: Series, b: Series) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the coherence along each one's direction of largest variance; empty for short records and long gaps."""
    times, x = on_even_clock(a.times_s, _along_main(a))
    y, n = on_even_clock(b.times_s, _along_main(b))[1], len(times)
    length = 2 * n // (_SEGMENTS + 1)
    if length < _SHORTEST or not is_filled(a.times_s):
        return np.zeros(0), np.zeros(0), 0
    of = {"fs": (n - 1) / float(np.ptp(times)), "nperseg": length, "noverlap": length // 2}
    freqs, cross = csd(x, y, **of)
    power = welch(x, **of)[1] * welch(y, **of)[1]
    segments = 1 + (n - length) // (length - length // 2)
    return freqs, np.abs(cross) ** 2 / np.maximum(power, 1e-300), segments


def _along_main(series: Series) -> np.ndarray:
    """Return the displacement [T] along the direction of largest variance."""
    values = np.where(series.is_resolved, series.displacement, 0)
    main = np.linalg.eigh(values.T @ values)[1][:, -1]
    return np.asarray(values @ main)
