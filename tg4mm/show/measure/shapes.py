"""Operating deflection shapes: how every Gaussian moves at the frequencies that stand out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult

_SAME = 0.75  # of 1 / duration: nearer than this two frequencies are one
_TOLD = 2.0  # deviations that a Gaussian's motion must stand out of
_MOST = 6


@dataclass(frozen=True)
class Shape:
    """At one frequency: phasors of the run's modes there, displacement = Re[phasor exp(i 2π f t)], t in seconds."""

    frequency_hz: float
    phasors: np.ndarray  # [N, 3] complex64, scene units
    is_above: np.ndarray  # [N] bool: stands out of twice the run's own deviation there


def shapes_of(scene: Prepared, results: Sequence[SensorResult]) -> tuple[Shape, ...]:
    """At the peaks of all sensors together, strongest first, where the run's modes move at all."""
    motion = scene.fit.motion
    if motion is None or not len(motion.freqs_hz):
        return ()
    resolution = 1 / scene.observations.duration_s
    found: list[tuple[float, float]] = []
    for result in results:
        for peak, orbit in zip(result.spectrum.peaks, result.orbits, strict=True):
            found.append((orbit.amplitude, peak.frequency_hz))
    hz: list[float] = []
    for _, f in sorted(found, reverse=True):
        if all(abs(f - other) > _SAME * resolution for other in hz):
            hz.append(f)
    deviation = scene.fit.uncertainty.get("displacement")
    out = []
    for f in hz[:_MOST]:
        phasors = _phasors(scene, f, resolution)
        size = np.sqrt((np.abs(phasors) ** 2).sum(1))
        if not size.any():
            continue
        least = 0.0 if deviation is None else _TOLD * deviation * np.sqrt(2)  # of amplitudes, not of rms
        out.append(Shape(f, phasors, size > least))
    return tuple(out)


def _phasors(scene: Prepared, frequency_hz: float, resolution: float) -> np.ndarray:
    """[N, 3] of all modes within three quarters of a bin: a sinusoid off the bins has its own, or is in two."""
    motion = scene.fit.motion
    assert motion is not None
    near = np.abs(motion.freqs_hz - frequency_hz) <= _SAME * resolution
    if not near.any():
        return np.zeros(motion.displacement.shape[1:], np.complex64)
    times = scene.clocks[0].times_s
    turn = np.exp(2j * np.pi * np.outer(motion.freqs_hz[near] - frequency_hz, times))
    return np.tensordot(turn.mean(1).astype(np.complex64), motion.displacement[near], 1)
