"""A run's files read as its `Result`."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.look import Found
from tg4mm.capture.scene import between_frames
from tg4mm.core.choices import Kind
from tg4mm.core.errors import RunError
from tg4mm.core.phasors import peak_displacement, scale_top
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.config import asked_band
from tg4mm.fit.motion.mode_selection import peaks, worth_keeping
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import PERIODS, frames_of
from tg4mm.fit.motion.picture_gain import LACKING
from tg4mm.run import UNCERTAINTY, Run
from tg4mm.run.checks import check_readout, check_times
from tg4mm.run.stages.look import look_of
from tg4mm.show.result.advice import next_command, suggested_alpha, suggested_bands
from tg4mm.show.result.asked import asked_vibration
from tg4mm.show.result.line import (
    Peak,
    drift_line,
    is_drift,
    line_near,
    mode_deviations,
    phasors_at,
    series_of,
    why_no_damping,
)
from tg4mm.show.result.looked import cannot_tell, looked_vibrations
from tg4mm.show.result.model import Band, Length, Result, Vibration
from tg4mm.show.result.reach import Reach, Seen, reach_of, seen_by

_LARGEST = 0.99  # of the weight of what is seen lies below the amplitude that is named, as in pixels
_HELD_STILL = 1e-6  # of the largest noise: less is of Gaussians that the fit holds still
_STEADY = "the fit takes the vibration to be steady"
_DOUBT = "only the whole picture shows it, no region by itself: it may be a little sway, a passer-by or noise"


def result_of(run: Run, band: Band | None = None) -> Result:
    """What the run found. Of a finished run it is the same each time. Raises RunError for one that is not finished.

    band: (low, high) in Hz that a person asks for: what the fit holds there is among the vibrations, found or not.
    """
    return reading_of(run).result(band)


def reading_of(run: Run) -> "Reading":
    """The files of a run. Raises RunError for one that is not finished, or whose dataset has other times now."""
    motion = run.load_motion()
    capture = load_capture(run.dataset) if run.dataset.is_dir() else None
    if motion is None and capture is not None and capture.n_timesteps > 1:
        raise RunError(f"{run.path} has no motion.safetensors: its motion stage is not finished")
    if motion is not None and capture is not None:
        of_run, of_dataset = (motion.fps, motion.n_timesteps), (capture.fps, capture.n_timesteps)
        check_times(run.path, run.dataset, of_run, of_dataset)
        check_readout(run.path, run.dataset, run.log().get("motion", {}), capture.rows_s)
    uncertainty = _uncertainty(run) if motion is not None else {}
    return Reading(run, run.load_space(), motion, run.log().get("motion", {}), capture, uncertainty)


@dataclass(frozen=True)
class Reading:
    """The files of a run that a result is read from."""

    run: Run
    gaussians: Gaussians
    motion: ModalMotion | None
    log: dict[str, Any]  # of the motion stage
    capture: Capture | None  # None: the dataset is gone
    uncertainty: dict[str, np.ndarray]  # {}: the run does not say it

    @property
    def duration_s(self) -> float:
        """Of the record, frames that are missing among it. 0 for a run without motion."""
        if self.motion is None:
            return 0.0
        return float(self.log.get("duration_s") or self.motion.n_timesteps / self.motion.fps)

    @cached_property
    def seen(self) -> Seen:
        return seen_by(self.gaussians, self.capture)

    @cached_property
    def _between(self) -> np.ndarray | None:
        """[T] bool: frames that a codec predicts from both sides; None where that is not known."""
        if self.capture is None or self.motion is None:
            return None
        return between_frames(self.capture.root, self.motion.n_timesteps)

    def result(self, band: Band | None = None) -> Result:
        """`result_of`."""
        motion = self.motion
        if motion is None:
            return self._still()
        seen = self.seen
        has_regions = self.look is not None and bool(self.look.vibrations)
        found = [] if has_regions else self._found(motion, seen)
        drifts = [v for v in found if is_drift(v, self.duration_s)]
        vibrations, beside = self._named(motion, seen, [v for v in found if v not in drifts])
        vibrations = self._with_asked(motion, vibrations, band)
        noise, noise_px = self._noise(seen)
        low, high = vibrations[0].band if vibrations else (0.0, 0.0)
        strongest = (motion.freqs_hz >= low) & (motion.freqs_hz <= high)
        alpha = suggested_alpha(self.reach(strongest.astype(float)) if vibrations else None, self.capture)
        frames = frames_of(self.capture)[1] if self.capture is not None else []
        return Result(
            run=self.run.path,
            kind=None if self.capture is None else self.capture.kind,
            n_cameras=len(frames),
            n_timesteps=motion.n_timesteps,
            fps=motion.fps,
            vibrations=vibrations,
            untold_hz=self._untold(motion),
            unit_scale_m=None if self.capture is None else self.capture.unit_scale_m,
            noise=noise,
            noise_px=noise_px,
            agreement=tuple(float(r) for r in self.log.get("reliability", ())),
            cannot=(
                *(f"whether something vibrates at {v.hz:.4g} Hz: {v.doubt}" for v in vibrations if v.doubt),
                *drift_line(drifts, self.duration_s),
                *cannot_tell(self, motion, vibrations),
            ),
            alpha=alpha,
            next_command=next_command(self.run, self.capture, vibrations, alpha),
            beside=beside,
        )

    def _with_asked(
        self, motion: ModalMotion, found: tuple[Vibration, ...], band: Band | None
    ) -> tuple[Vibration, ...]:
        """With the motion in the band that is asked for, or that the run was trained for, first; as it is if found."""
        band = band or asked_band(str(self.run.settings.get("motion", {}).get("band", "")), motion.fps)
        if band is None or any(band[0] <= v.hz <= band[1] for v in found):
            return found
        asked = asked_vibration(self, band)
        return found if asked is None else (asked, *found)

    @cached_property
    def look(self) -> Found | None:
        """What the look at a flat capture's regions found."""
        return None if self.capture is None or self.capture.kind.sees_depth else look_of(self.run)

    def _named(
        self, motion: ModalMotion, seen: Seen, found: list[Peak]
    ) -> tuple[tuple[Vibration, ...], tuple[Vibration, ...]]:
        """The vibrations that the model holds, and others; where a flat capture's regions name some, these alone.

        Where they name none, the whole picture may still show what no region does: motion that is no steady tone, but
        also a little sway or noise.
        """
        if self.look is None or self.capture is None:
            return self._vibrations(motion, seen, found), ()
        if not self.look.vibrations:
            return tuple(replace(v, doubt=_DOUBT) for v in self._vibrations(motion, seen, found)), ()
        every = looked_vibrations(self.look, self.capture, motion.fps, self.duration_s)
        hz = np.asarray(motion.freqs_hz)
        held = [bool(((hz >= v.band[0]) & (hz <= v.band[1])).any()) for v in every]
        inside = tuple(v for v, is_held in zip(every, held, strict=True) if is_held)
        return inside, tuple(v for v, is_held in zip(every, held, strict=True) if not is_held)

    def _still(self) -> Result:
        """Of a capture of one timestep."""
        capture = self.capture
        return Result(
            run=self.run.path,
            kind=Kind.photos if capture is None else capture.kind,
            n_cameras=0 if capture is None else len(capture),
            n_timesteps=1,
            fps=0.0,
            vibrations=(),
            untold_hz=(),
            unit_scale_m=None if capture is None else capture.unit_scale_m,
            noise=None,
            noise_px=None,
            agreement=(),
            cannot=("motion: there is one timestep, at which nothing can move",),
            alpha=0.0,
            next_command=next_command(self.run, capture, (), 0.0),
        )

    def peak_bands(self) -> list[tuple[float, Band]]:
        """(frequency, band) of every vibration, then of what else stands out, what may be a drift among it."""
        if self.motion is None:
            return []
        known = {v.hz: v.band for v in self.result().vibrations}
        found = [v.hz for v in self._found(self.motion, self.seen)]
        hz = [*known, *(f for f in found if all(not low <= f <= high for low, high in known.values()))]
        bands = suggested_bands(hz, [0.0] * len(hz), self.duration_s, self.motion.fps)
        return [(f, known.get(f, band)) for f, band in zip(hz, bands, strict=True)]

    def _found(self, motion: ModalMotion, seen: Seen) -> list[Peak]:
        """Every peak, drifts among them, by falling strength; none within a stronger one's line."""
        hz = [float(f) for f in peaks(motion, PERIODS / self.duration_s, self.uncertainty.get("noise"))]
        told = {float(f): float(d) for f, d in zip(*(self.log.get(k, ()) for k in _STATED), strict=False)}
        out: list[Peak] = []
        for f in hz:
            if (
                told
            ):  # clocks of their own, or a moving camera: the fit holds these frequencies and nothing else
                out.append(Peak(f, f, told[min(told, key=lambda g: abs(g - f))], None, is_steady=True))
                continue
            own = self._line(motion, seen, f, [g for g in hz if g != f])
            if all(abs(own.hz - v.hz) >= v.reach(self.duration_s) for v in out):
                out.append(own)
        return out

    def _line(self, motion: ModalMotion, seen: Seen, hz: float, others: list[float]) -> Peak:
        series = series_of(motion, motion.displacement[_index(motion, hz)], seen.weights)
        noise = float(self.log.get("noise_to_motion") or 0.0)
        line = line_near(series, motion.fps, hz, others, noise, self._between)
        if line is None:  # a bin, uniformly distributed
            return Peak(hz, hz, 1 / (self.duration_s * np.sqrt(12)), None)
        return Peak(hz, line.hz, line.hz_deviation, line)

    def _vibrations(self, motion: ModalMotion, seen: Seen, found: list[Peak]) -> tuple[Vibration, ...]:
        bands = suggested_bands(
            [v.hz for v in found], [v.deviation_hz for v in found], self.duration_s, motion.fps,
            [v.reach(self.duration_s) for v in found],
        )  # fmt: skip
        deviations = None
        if "noise" in self.uncertainty:
            deviations = mode_deviations(motion, self.uncertainty["displacement"], self.uncertainty["noise"])
        out = []
        for v, band in zip(found, bands, strict=True):
            k, line = _index(motion, v.mode_hz), v.line
            phasors = motion.displacement[k] if line is None else phasors_at(motion, line, self._between)
            amplitude, place = self.largest(phasors, seen, None if deviations is None else deviations[k])
            if amplitude.deviation is not None and amplitude.value < amplitude.deviation:
                continue  # as large as its own error
            amplitude = replace(amplitude, is_bound=self._is_bound(v.hz))
            out.append(
                Vibration(
                    hz=v.hz,
                    deviation_hz=v.deviation_hz,
                    amplitude=amplitude,
                    place=place,
                    pixels=self.pixels(phasors, seen, amplitude),
                    damping=None if line is None else line.damping,
                    damping_deviation=None if line is None else line.damping_deviation,
                    why_no_damping=_STEADY if v.is_steady else why_no_damping(line),
                    band=band,
                    place_px=self.pixel(place),
                    begins_s=None if line is None else line.start_s,
                )
            )
        return tuple(out)

    def _untold(self, motion: ModalMotion) -> tuple[Length, ...]:
        """What a fit found a frequency of, and let go since its two halves did not agree on the motion."""
        if len(motion.freqs_hz):
            return ()
        return tuple(Length(f, d) for f, d in zip(*(self.log.get(k, ()) for k in _STATED), strict=False))

    def largest(
        self, phasors: np.ndarray, seen: Seen, deviation: np.ndarray | None
    ) -> tuple[Length, tuple[float, float, float]]:
        amplitude = peak_displacement(phasors)
        top = scale_top(amplitude, seen.weights, _LARGEST)
        there = int(np.argmin(np.where(seen.weights > 0, np.abs(amplitude - top), np.inf)))
        x, y, z = (float(c) for c in self.gaussians.means[there])
        return Length(top, None if deviation is None else float(deviation[there])), (x, y, z)

    def pixel(self, place: tuple[float, float, float]) -> tuple[float, float] | None:
        """Of a flat capture, where a place lies in its picture."""
        if self.capture is None or self.capture.kind.sees_depth:
            return None
        viewmat, K = self.capture.viewmats[0].astype(np.float64), self.capture.Ks[0].astype(np.float64)
        x, y, z = K @ (viewmat[:3, :3] @ np.array(place) + viewmat[:3, 3])
        return float(x / z), float(y / z)

    def pixels(self, phasors: np.ndarray, seen: Seen, amplitude: Length) -> Length | None:
        """The deviation is as much of the motion in pixels as it is of that in scene units, but for what only the
        line of sight hides."""
        pixels = seen.pixels(phasors)
        if pixels is None or amplitude.deviation is None or not amplitude.value > 0:
            return None if pixels is None else Length(pixels, is_bound=amplitude.is_bound)
        deviation = pixels * amplitude.deviation / amplitude.value
        if "covariance" in self.uncertainty:
            own = self.uncertainty["covariance"].astype(np.float64)
            even = np.trace(own, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
            deviation *= (seen.rms_pixels(own) or 0.0) / max(seen.rms_pixels(even) or 0.0, 1e-30)
        return Length(pixels, deviation, amplitude.is_bound)

    def _is_bound(self, hz: float) -> bool:
        """Whether more may move than the model holds, by what the fit says of itself."""
        slow = np.array(self.log.get("lower_bound_hz", ()))
        return bool(
            self.log.get("picture_gain", 1.0) > LACKING or (np.abs(slow - hz) < 1 / self.duration_s).any()
        )

    def _noise(self, seen: Seen) -> tuple[float | None, float | None]:
        if "noise" not in self.uncertainty:
            return None, None
        noise = self.uncertainty["noise"].astype(np.float64)
        moves = noise > _HELD_STILL * noise.max(initial=0.0)
        own = np.sqrt(2) * scale_top(noise, np.where(moves, seen.weights, 0), 0.5)
        pixels = seen.rms_pixels((noise**2 / 3)[:, None, None] * np.eye(3))
        return own, None if pixels is None else np.sqrt(2) * pixels

    def reach(self, gains: np.ndarray) -> Reach | None:
        """How far the motion goes with its modes multiplied by `gains` [K]; None for a run without motion."""
        if self.motion is None:
            return None
        told = worth_keeping(self.motion, self.uncertainty.get("noise"))
        noise_px, is_decoded = self._noise(self.seen)[1], self.run.preset != "modal"
        return reach_of(self.gaussians, self.motion, self.seen, noise_px, gains * told, is_decoded)


_STATED = ("frequencies_hz", "frequency_deviation_hz")


def _index(motion: ModalMotion, hz: float) -> int:
    return int(np.argmin(np.abs(motion.freqs_hz - hz)))


def _uncertainty(run: Run) -> dict[str, np.ndarray]:
    if not run.has_part(UNCERTAINTY):
        return {}
    return {name: tensor.numpy() for name, tensor in run.load_part(UNCERTAINTY)[0].items()}
