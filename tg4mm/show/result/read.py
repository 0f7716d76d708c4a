"""Reads the `Result` of a run from its files."""

from dataclasses import replace

import numpy as np

from tg4mm.capture.look import LookSummary
from tg4mm.core.choices import Kind
from tg4mm.core.lines import CodecChange
from tg4mm.core.lines.band import FEWEST, BandLine, tone_in
from tg4mm.fit.motion.config import asked_band
from tg4mm.fit.motion.mode_selection import peaks
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import PERIODS, frames_of
from tg4mm.run import Run
from tg4mm.run.stages import look_of
from tg4mm.show.result.advice import next_command, suggested_alpha, suggested_bands
from tg4mm.show.result.looked import cannot_tell, depths_of, looked_vibrations
from tg4mm.show.result.model import (
    Band,
    Length,
    ModePeak,
    Result,
    Vibration,
    drift_line,
    is_drift,
    line_near,
    phasors_at,
    series_of,
    why_no_damping,
)
from tg4mm.show.result.reading import ResultSources, reading_of

_STEADY = "the fit assumes a steady vibration"
_DOUBT = "only the whole picture shows it, no region by itself: it may be a little sway, a passer-by or noise"


def _requested(reading: ResultSources, band: Band) -> Vibration | None:
    """Return the motion of the run's modes in a band, with a large ± that shows the doubt; None without a mode.

    The shape is that of the strongest mode in the band. Its size and frequency are those of the motion's tone along
    that shape (`core/lines/band.py`), or of the mode if the fit has only tones.
    """
    motion = reading.motion
    if motion is None:
        return None
    hz = np.asarray(motion.freqs_hz)
    inside = np.flatnonzero((hz >= band[0]) & (hz <= band[1]) & motion.is_magnified())
    if not len(inside):
        return None
    weights = reading.seen.weights
    k = int(inside[motion.powers(weights)[inside].argmax()])
    tone, share = _tone(reading, motion, k, band)
    phasors = motion.displacement_of(k) * np.complex64(1.0 if tone is None else abs(tone.phasor[0]))
    amplitude, position = reading.largest(phasors, k)
    deviation = float(np.hypot(amplitude.deviation or 0.0, share * amplitude.value))
    amplitude = replace(amplitude, deviation=deviation)
    frequency, width = float(hz[k]), (band[1] - band[0]) / np.sqrt(12)
    if tone is not None:
        frequency, width = tone.hz, tone.hz_deviation
    periods = frequency * reading.duration_s
    return Vibration(
        hz=frequency,
        deviation_hz=width,
        amplitude=amplitude,
        position=position,
        pixels=reading.pixels(phasors, amplitude),
        why_no_damping="no line was detected in the band",
        band=band,
        position_px=reading.pixel(position),
        doubt=f"no line was detected in the given band, {band[0]:g} to {band[1]:g} Hz; the record holds "
        f"{periods:.2g} periods of it, and the ± includes a drift as large as the motion",
    )


def _tone(reading: ResultSources, motion: ModalMotion, k: int, band: Band) -> tuple[BandLine | None, float]:
    """Return the tone of the motion along mode k in units of the mode, and its amplitude's relative deviation."""
    if "asked_share" in reading.log:
        return None, float(reading.log["asked_share"])
    if motion.n_timesteps < FEWEST:
        return None, 1.0
    series = series_of(motion, motion.displacement_of(k), reading.seen.weights)
    noise = float(reading.log.get("noise_to_motion") or 0.0) * float(np.sqrt((series**2).mean()))
    tone = tone_in(series, np.arange(len(series)) / motion.fps, band, noise)
    return tone, float(tone.amplitude_deviation[0]) / max(abs(tone.phasor[0]), 1e-300)


def result_of(run: Run, band: Band | None = None) -> Result:
    """Read the result of a finished run, which is always the same. Raises RunError for an unfinished one.

    band: requested (low, high) in Hz; the fit's motion there is among the vibrations, significant or not.
    """
    return result_from(reading_of(run), band)


def result_from(reading: ResultSources, band: Band | None = None) -> Result:
    """Return the result from a run's files, as `result_of`."""
    motion = reading.motion
    if motion is None:
        return _still(reading)
    found = [] if _by_regions(reading) else _found(reading, motion)
    drifts = [v for v in found if is_drift(v, reading.duration_s)]
    vibrations, beside = _named(reading, motion, [v for v in found if v not in drifts])
    vibrations = _with_requested(reading, motion, vibrations, band)
    noise, noise_px = reading.noise()
    low, high = vibrations[0].band if vibrations else (0.0, 0.0)
    strongest = (motion.freqs_hz >= low) & (motion.freqs_hz <= high)
    alpha = suggested_alpha(reading.limits(strongest.astype(float)) if vibrations else None, reading.capture)
    capture = reading.capture
    return Result(
        run=reading.run.path,
        kind=None if capture is None else capture.kind,
        n_cameras=0 if capture is None else len(frames_of(capture)[1]),
        n_timesteps=motion.n_timesteps,
        fps=motion.fps,
        vibrations=vibrations,
        shapeless_hz=_shapeless(reading, motion),
        unit_scale_m=None if capture is None else capture.unit_scale_m,
        noise=noise,
        noise_px=noise_px,
        agreement=tuple(float(r) for r in reading.log.get("reliability", ())),
        cannot=(
            *(f"whether something vibrates at {v.hz:.4g} Hz: {v.doubt}" for v in vibrations if v.doubt),
            *drift_line(drifts, reading.duration_s),
            *cannot_tell(reading, motion, vibrations),
        ),
        alpha=alpha,
        next_command=next_command(reading.run, capture, vibrations, alpha),
        beside=beside,
    )


def _with_requested(
    reading: ResultSources, motion: ModalMotion, found: tuple[Vibration, ...], band: Band | None
) -> tuple[Vibration, ...]:
    """Put the motion in the requested band, or in the band of training, first unless it was found already."""
    band = band or asked_band(str(reading.run.settings.get("motion", {}).get("band", "")), motion.fps)
    if band is None or any(band[0] <= v.hz <= band[1] for v in found):
        return found
    requested = _requested(reading, band)
    return found if requested is None else (requested, *found)


def _named(
    reading: ResultSources, motion: ModalMotion, found: list[ModePeak]
) -> tuple[tuple[Vibration, ...], tuple[Vibration, ...]]:
    """Return the model's vibrations, and others; of a flat capture only those of its regions, if there are any.

    Otherwise the complete picture may still show motion that no region shows: not a steady tone, but also a little
    sway or noise. For a scene with depth it is the model's, and beside them those that only a region shows.
    """
    if reading.look is None or reading.capture is None:
        return _vibrations(reading, motion, found), ()
    is_flat = not reading.capture.kind.sees_depth
    if is_flat and not reading.look.vibrations:
        return tuple(replace(v, doubt=_DOUBT) for v in _vibrations(reading, motion, found)), ()
    depths = None if is_flat else depths_of(reading, reading.look, reading.capture)
    every = looked_vibrations(reading.look, reading.capture, motion.fps, reading.duration_s, depths)
    hz = np.asarray(motion.freqs_hz)
    if not is_flat:
        model = not_of_light(_vibrations(reading, motion, found), reading.look, reading.duration_s)
        return _with_regions(model, every, hz)
    held = [bool(((hz >= v.band[0]) & (hz <= v.band[1])).any()) for v in every]
    inside = tuple(v for v, is_held in zip(every, held, strict=True) if is_held)
    return inside, tuple(v for v, is_held in zip(every, held, strict=True) if not is_held)


def _by_regions(reading: ResultSources) -> bool:
    """Return whether the vibrations are those of a flat capture's regions."""
    is_flat = reading.capture is not None and not reading.capture.kind.sees_depth
    return is_flat and reading.look is not None and bool(reading.look.vibrations)


def _with_regions(
    found: tuple[Vibration, ...], every: tuple[Vibration, ...], hz: np.ndarray
) -> tuple[tuple[Vibration, ...], tuple[Vibration, ...]]:
    """Return the model's vibrations, those of a small part as its region has them, and those outside the model."""
    inside, beside = list(found), list[Vibration]()
    for line in every:
        near = [k for k, v in enumerate(inside) if v.band[0] <= line.hz <= v.band[1]]
        if not near:
            held = bool(((hz >= line.band[0]) & (hz <= line.band[1])).any())
            (inside if held else beside).append(line)
        elif _is_local(inside[near[0]], line):
            inside[near[0]] = replace(line, band=inside[near[0]].band)
    inside.sort(key=lambda v: (bool(v.doubt), -v.amplitude.value))
    return tuple(inside), tuple(beside)


def not_of_light(found: tuple[Vibration, ...], look: LookSummary, duration_s: float) -> tuple[Vibration, ...]:
    """Return the vibrations; those at a frequency of the light that no region shows are in doubt."""
    moving = [(line.hz, line.hz_deviation) for line in look.vibrations]

    def is_near(v: Vibration, hz: float, deviation: float) -> bool:
        return abs(v.hz - hz) < max(1 / (2 * duration_s), 2 * float(np.hypot(v.deviation_hz, deviation)))

    out = []
    for v in found:
        light = [tone for tone in look.light if is_near(v, tone.hz, tone.hz_deviation)]
        if light and not any(is_near(v, *line) for line in moving):
            percent = 100 * light[0].amplitude
            v = replace(v, doubt=f"the light flickers there by {percent:.2g} %, and no region moves")
        out.append(v)
    return tuple(out)


def _is_local(model: Vibration, region: Vibration) -> bool:
    """Return whether a region moves more than twice as far as the model's visible scene."""
    if model.pixels is None or region.pixels is None:
        return False
    return model.pixels.value < region.pixels.value / 2


def _still(reading: ResultSources) -> Result:
    capture = reading.capture
    return Result(
        run=reading.run.path,
        kind=Kind.photos if capture is None else capture.kind,
        n_cameras=0 if capture is None else len(capture),
        n_timesteps=1,
        fps=0.0,
        unit_scale_m=None if capture is None else capture.unit_scale_m,
        cannot=("motion: there is one timestep, at which nothing can move",),
        alpha=0.0,
        next_command=next_command(reading.run, capture, (), 0.0),
    )


def peak_bands(reading: ResultSources) -> list[tuple[float, Band]]:
    """Return frequency and band of every vibration, then of the other peaks, drifts included."""
    if reading.motion is None:
        return []
    known = {v.hz: v.band for v in result_from(reading).vibrations}
    found = [v.hz for v in _found(reading, reading.motion)]
    hz = [*known, *(f for f in found if all(not low <= f <= high for low, high in known.values()))]
    bands = suggested_bands(hz, [0.0] * len(hz), reading.duration_s, reading.motion.fps)
    return [(f, known.get(f, band)) for f, band in zip(hz, bands, strict=True)]


def _found(reading: ResultSources, motion: ModalMotion) -> list[ModePeak]:
    """Return every peak, drifts included, the strongest first; none within a stronger one's line."""
    known = [] if reading.look is None else list({line.hz for line in reading.look.vibrations})
    noise = reading.uncertainty.get("noise")
    hz = [float(f) for f in peaks(motion, PERIODS / reading.duration_s, noise, known)]
    stated = {length.value: length.deviation or 0.0 for length in _stated(reading)}
    out: list[ModePeak] = []
    for f in hz:
        if stated:  # separate clocks, or a moving camera: the fit has only these frequencies
            out.append(ModePeak(f, f, stated[min(stated, key=lambda g: abs(g - f))], None, is_steady=True))
            continue
        peak = _line(reading, motion, f, [g for g in hz if g != f])
        if all(abs(peak.hz - v.hz) >= v.half_width_hz(reading.duration_s) for v in out):
            out.append(peak)
    return out


def _line(reading: ResultSources, motion: ModalMotion, hz: float, others: list[float]) -> ModePeak:
    series = series_of(motion, motion.displacement_of(_index(motion, hz)), reading.seen.weights)
    noise = float(reading.log.get("noise_to_motion") or 0.0)
    codec = None if reading.look is None else CodecChange(reading.look.coded_change)
    line = line_near(series, motion.fps, hz, others, noise, reading.b_frames, codec)
    if line is None:  # a bin, uniformly distributed
        return ModePeak(hz, hz, 1 / (reading.duration_s * np.sqrt(12)), None)
    return ModePeak(hz, line.hz, at_least_seen(line.hz, line.hz_deviation, look_of(reading.run)), line)


def at_least_seen(hz: float, deviation: float, look: LookSummary | None) -> float:
    """Return a frequency's deviation (Hz), at least that of the same line in a region, which includes the codec."""
    lines = [] if look is None else look.lines
    return max([deviation, *(n.hz_deviation for n in lines if abs(n.hz - hz) < 2 * n.hz_deviation)])


def _vibrations(reading: ResultSources, motion: ModalMotion, found: list[ModePeak]) -> tuple[Vibration, ...]:
    bands = suggested_bands(
        [v.hz for v in found], [v.deviation_hz for v in found], reading.duration_s, motion.fps,
        [v.half_width_hz(reading.duration_s) for v in found],
    )  # fmt: skip
    out = []
    for v, band in zip(found, bands, strict=True):
        k, line = _index(motion, v.mode_hz), v.line
        phasors = motion.displacement_of(k) if line is None else phasors_at(motion, line, reading.b_frames)
        amplitude, position = reading.largest(phasors, k)
        if amplitude.deviation is not None and amplitude.value < amplitude.deviation:
            continue  # not larger than its error
        amplitude = replace(amplitude, is_bound=reading.is_bound(v.hz))
        out.append(
            Vibration(
                hz=v.hz,
                deviation_hz=v.deviation_hz,
                amplitude=amplitude,
                position=position,
                pixels=reading.pixels(phasors, amplitude),
                damping=None if line is None else line.damping,
                damping_deviation=None if line is None else line.damping_deviation,
                why_no_damping=_STEADY if v.is_steady else why_no_damping(line),
                band=band,
                position_px=reading.pixel(position),
                begins_s=None if line is None else line.start_s,
            )
        )
    return tuple(out)


def _shapeless(reading: ResultSources, motion: ModalMotion) -> tuple[Length, ...]:
    """Return the frequencies of motion that the fit dropped because its two halves disagreed."""
    return () if len(motion.freqs_hz) else _stated(reading)


def _stated(reading: ResultSources) -> tuple[Length, ...]:
    keys = ("frequencies_hz", "frequency_deviation_hz")
    return tuple(
        Length(float(f), float(d)) for f, d in zip(*(reading.log.get(k, ()) for k in keys), strict=False)
    )


def _index(motion: ModalMotion, hz: float) -> int:
    return int(np.argmin(np.abs(motion.freqs_hz - hz)))
