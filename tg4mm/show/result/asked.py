"""The motion in a band that a person gives, where nothing there stands out by itself."""

from dataclasses import replace

import numpy as np

from tg4mm.core.lines.band import FEWEST, Tone, tone_in
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.result.line import mode_deviations, series_of
from tg4mm.show.result.model import Band, Vibration
from tg4mm.show.result.reading import Reading


def asked_vibration(reading: Reading, band: Band) -> Vibration | None:
    """What the run's modes in a band amount to, with a ± that says how little the record tells; None without a mode.

    The shape is that of the strongest mode in the band. How large it is, and its frequency, is the tone of the motion
    along that shape (`core/lines/band.py`); where the fit holds nothing but tones, what it said of this one.
    """
    motion = reading.motion
    if motion is None:
        return None
    hz = np.asarray(motion.freqs_hz)
    inside = np.flatnonzero((hz >= band[0]) & (hz <= band[1]) & motion.is_magnified())
    if not len(inside):
        return None
    weights = reading.seen.weights
    power = np.einsum("knc,n->k", np.abs(motion.displacement[inside]) ** 2, weights)
    k = int(inside[power.argmax()])
    own, share = _tone(reading, motion, k, band)
    phasors = motion.displacement[k] * np.complex64(1.0 if own is None else abs(own.phasor[0]))
    deviations = None
    if "noise" in reading.uncertainty:
        deviations = mode_deviations(
            motion, reading.uncertainty["displacement"], reading.uncertainty["noise"]
        )[k]
    amplitude, place = reading.largest(phasors, deviations)
    deviation = float(np.hypot(amplitude.deviation or 0.0, share * amplitude.value))
    amplitude = replace(amplitude, deviation=deviation)
    frequency, width = (
        (float(hz[k]), (band[1] - band[0]) / np.sqrt(12)) if own is None else (own.hz, own.hz_deviation)
    )
    periods = frequency * reading.duration_s
    return Vibration(
        hz=frequency,
        deviation_hz=width,
        amplitude=amplitude,
        place=place,
        pixels=reading.pixels(phasors, amplitude),
        damping=None,
        damping_deviation=None,
        why_no_damping="nothing stands out in the band",
        band=band,
        place_px=reading.pixel(place),
        doubt=f"nothing stands out from {band[0]:g} to {band[1]:g} Hz, which was asked for; the record holds "
        f"{periods:.2g} periods of it, and the ± a drift as large as the motion",
    )


def _tone(reading: Reading, motion: ModalMotion, k: int, band: Band) -> tuple[Tone | None, float]:
    """Of the motion along mode k in units of the mode's own, and its amplitude's deviation over it."""
    if "asked_share" in reading.log:
        return None, float(reading.log["asked_share"])
    if motion.n_timesteps < FEWEST:
        return None, 1.0
    series = series_of(motion, motion.displacement[k], reading.seen.weights)
    noise = float(reading.log.get("noise_to_motion") or 0.0) * float(np.sqrt((series**2).mean()))
    tone = tone_in(series, np.arange(len(series)) / motion.fps, band, noise)
    return tone, float(tone.amplitude_deviation[0]) / max(abs(tone.phasor[0]), 1e-300)
