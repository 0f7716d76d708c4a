"""Time and frequency of a splat object: position in its recording; strengths, peaks and bands of its modes."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import compat, names

FEWEST_FRAMES = 4.0  # of a period: with fewer, a vibration does not look like one
GOOD_FRAMES = 12  # of a period: with as many, it looks smooth
PEAK_ABOVE = 0.05  # of the largest amplitude
DIP = 0.8  # of a peak: how low it must be between it and a larger one, or it is that one's skirt
NEIGHBOURS = 1.5  # frequency bins; what is farther apart has a bin without motion between
MOST_PEAKS = 6


def rate(scene: Any) -> float:
    """Return the scene's frames per second."""
    return float(scene.render.fps / scene.render.fps_base)


def slow_motion(scene: Any, frequency_hz: float) -> int:
    """Return by how many times motion has to be slower so that a period has GOOD_FRAMES frames; 1: it needs not."""
    return max(1, math.ceil(GOOD_FRAMES * frequency_hz / rate(scene) - 1e-6))


def timestep(scene: Any, obj: Any, modifier: Any) -> float:
    """Return the fractional number of timesteps since the first frame."""
    first, speed = (compat.get_number(modifier, name) for name in (names.FIRST, names.SPEED))
    fps = float(obj[names.FPS])
    return (scene.frame_current_final - first) * speed * (fps / rate(scene) if fps else 1.0)


def lines(scene: Any, obj: Any, modifier: Any) -> list[str]:
    """Return the panel's lines: time, playback speed, and a warning if frames undersample the motion."""
    fps, steps = float(obj[names.FPS]), int(obj[names.TIMESTEPS])
    if not fps:
        return []
    now, speed = timestep(scene, obj, modifier) / fps, compat.get_number(modifier, names.SPEED)
    said = [f"{min(max(now, 0.0), steps / fps):.3f} s of {steps / fps:.3f} s, {pace(speed)}"]
    if not 0 <= now <= steps / fps:
        said.append(f"{'Before' if now < 0 else 'After'} the recording: motion continues")
    low, high = (compat.get_number(modifier, name) for name in (names.LOW, names.HIGH))
    inside = [float(f) for f in obj[names.FREQUENCIES] if low <= f <= high]
    fastest = max(inside, default=0.0)
    if fastest * abs(speed) * FEWEST_FRAMES > rate(scene):
        said.append(f"{rate(scene) / (fastest * abs(speed)):.1f} frames per period at {fastest:.4g} Hz")
        said.append("Motion will strobe: lower Speed")
    return said


def not_finite(modifier: Any) -> list[str]:
    """Return a warning for each non-finite input of the modifier; drivers and scripts can cause them."""
    shown = [name for name in (names.ALPHA, names.SPEED, names.FIRST) if compat.has_input(modifier, name)]
    values = {name: float(compat.get_input(modifier, name)) for name in shown}
    return [
        f"{name} is {value:g}: plays as 0" for name, value in values.items() if not compat.is_number(value)
    ]


def pace(speed: float) -> str:
    """Format a speed: "real time", "10 × slower"."""
    if speed in (0.0, 1.0):
        return "real time" if speed else "stopped"
    way = "" if speed > 0 else "backwards, "
    size = abs(speed)
    if size == 1:
        return "backwards"
    return way + (f"{1 / size:.4g} × slower" if size < 1 else f"{size:.4g} × faster")


def rms_amplitude(amplitudes: np.ndarray, weights: np.ndarray) -> float:
    """Return √(Σ w a² / Σ w) of amplitudes [N] with weights [N]; the plain rms if all weights are 0."""
    a, w = np.asarray(amplitudes, np.float64), np.asarray(weights, np.float64)
    return float(np.sqrt((w * a**2).sum() / w.sum() if w.sum() > 0 else (a**2).mean()))


def peaks(freqs_hz: Sequence[float], amplitudes: Sequence[float], bin_hz: float) -> list[int]:
    """Return the indices of the modes that are peaks, by frequency; at most the MOST_PEAKS largest.

    A recording of T timesteps tells frequencies apart that lie `bin_hz` = fps / T from each other; what vibrates
    between two bins leaks into all, less the farther they are. So a mode is a peak if on the way to any larger
    one there is a dip: a mode below DIP times its own amplitude, or a bin without a mode. Of modes alike the
    lower counts, and none counts that is too small to matter.
    """
    order = np.argsort(freqs_hz, kind="stable")
    f, a = np.asarray(freqs_hz, float)[order], np.asarray(amplitudes, float)[order]
    large = [i for i in range(len(a)) if a[i] > 0 and a[i] >= PEAK_ABOVE * a.max()]
    found = [i for i in large if _stands_out(f, a, i, -1, bin_hz) and _stands_out(f, a, i, 1, bin_hz)]
    return [int(order[i]) for i in sorted(sorted(found, key=lambda i: -a[i])[:MOST_PEAKS])]


def _stands_out(f: np.ndarray, a: np.ndarray, i: int, step: int, bin_hz: float) -> bool:
    """True if going from mode i by `step` (−1 down, +1 up) a dip comes before anything larger, or nothing does."""
    j = i + step
    while 0 <= j < len(a) and abs(f[j] - f[j - step]) <= NEIGHBOURS * bin_hz:
        if a[j] < DIP * a[i]:
            return True
        if a[j] > a[i] or (a[j] == a[i] and step < 0):
            return False
        j += step
    return True


def band_around(frequency_hz: float, width_hz: float) -> tuple[float, float]:
    """Return (low, high) in Hz of a band `width_hz` wide centred on a frequency; never below 0."""
    return max(0.0, frequency_hz - width_hz / 2), frequency_hz + width_hz / 2


def whole_band(freqs_hz: Sequence[float], fps: float) -> tuple[float, float]:
    """Return the band from 0 to half the frame rate or, if larger, the highest frequency, in Hz."""
    return 0.0, max([fps / 2, *freqs_hz])
