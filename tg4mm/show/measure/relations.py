"""How a sensor moves against a reference sensor: phase at the reference's peaks, and coherence over frequency."""

import numpy as np
from scipy.signal import csd, welch

from tg4mm.core.even_clock import is_filled, on_even_clock
from tg4mm.core.lines import Line, fit_lines
from tg4mm.core.lines.band import Tone, tone_in
from tg4mm.show.measure.orbit import Orbit, orbit_in, orbit_of
from tg4mm.show.measure.sensor_result import PhaseAt, Relation, SensorResult
from tg4mm.show.measure.series import Series

_SEGMENTS = 4  # of a record, half overlapping
_SHORTEST = 16  # samples of a segment


def relation_of(result: SensorResult, reference: SensorResult) -> Relation:
    """Return no coherence: it is undefined for clips."""
    phases = []
    at_peaks = _at(result, reference)
    for k, peak in enumerate(reference.spectrum.peaks):
        orbit = orbit_of(peak)
        own, is_above = at_peaks[k]
        phase, amplitude = own.phase - orbit.phase, own.amplitude
        mine, its = (o.deviation / max(o.amplitude, 1e-300) for o in (own, orbit))
        error = float(np.hypot(mine, its))
        phases.append(
            PhaseAt(
                peak.frequency_hz,
                amplitude,
                float((phase + np.pi) % (2 * np.pi) - np.pi),
                min(error, np.pi),
                is_above,
            )
        )
    freqs, coherence, segments = np.zeros(0), np.zeros(0), 0
    if result.together is None:
        freqs, coherence, segments = _coherence(result.series, reference.series)
    chance = 1 - 0.05 ** (1 / (segments - 1)) if segments > 1 else 1.0
    return Relation(reference.name, tuple(phases), freqs, coherence, segments, chance)


def _at(result: SensorResult, reference: SensorResult) -> list[tuple[Orbit, bool]]:
    """A sensor's orbit at each of the reference's peaks, and whether it stands out."""
    peaks, level = reference.spectrum.peaks, result.spectrum.floor.min(0)
    if result.together is not None:
        own = [
            min(result.together.everywhere, key=lambda p: abs(p.frequency_hz - q.frequency_hz)) for q in peaks
        ]
        return [(orbit_of(p), bool((p.amplitude > level)[p.is_resolved].any())) for p in own]
    lines = [p.line for p in peaks if p.line is not None]
    series, out = result.series, []
    told = series.is_resolved
    values = series.displacement[:, told]
    found: list[Line | Tone] = []
    if lines:
        found += fit_lines(values, series.times_s, lines).lines
    known = np.sqrt((series.noise[:, told] ** 2).mean(0))
    for p in peaks[len(lines) :]:  # what was asked for comes last: at the reference's own frequency
        found.append(tone_in(values, series.times_s, (0.999 * p.frequency_hz, 1.001 * p.frequency_hz), known))
    for one in found:
        phasor, error = np.zeros(len(level), complex), np.zeros(len(level))
        phasor[told], error[told] = one.phasor, one.amplitude_deviation
        is_above = bool((np.abs(phasor) > np.maximum(level, 2 * error)).any())
        out.append((orbit_in(phasor, error, told, series.correlation), is_above))
    return out


def _coherence(a: Series, b: Series) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the coherence of motion along each one's direction of largest variance.

    Nothing of short records and those with long gaps.
    """
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
    values = np.where(series.is_resolved, series.displacement, 0)
    main = np.linalg.eigh(values.T @ values)[1][:, -1]
    return np.asarray(values @ main)
