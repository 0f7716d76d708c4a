"""A clicked pixel: the surface seen there, its waveform and its spectrum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tg4mm.report.maps import main_direction, peak_displacement
from tg4mm.view.scene import Scene

_FAINTEST = 0.05  # opacity of a pixel that counts as hit


@dataclass(frozen=True)
class Waveform:
    """How the surface under a pixel moves, as captured (α = 0)."""

    point: np.ndarray  # [3] where it is, scene units
    direction: np.ndarray  # [3] unit vector of its main direction, world axes
    times: np.ndarray  # [F] seconds
    displacement: np.ndarray  # [F] along the direction, scene units, about its mean
    deviation: np.ndarray | None  # [F] standard deviation of that, scene units
    frequencies: np.ndarray  # [B] Hz
    amplitudes: np.ndarray  # [B] peak displacement, scene units


def modal_waveform(scene: Scene, weights: np.ndarray) -> Waveform | None:
    """The fitted motion of the Gaussians blended in a pixel, with their blending weights [N] there.

    None where the pixel shows background (opacity below 0.05), and where nothing moves. Displacements are blended as
    colours are; the standard deviation is that of a single Gaussian, as if all erred alike.
    """
    total = float(weights.sum())
    if scene.motion is None or not len(scene.frequencies) or total < _FAINTEST:
        return None
    rows = np.flatnonzero(weights > 1e-4 * total)
    share = weights[rows] / weights[rows].sum()
    seen = scene.motion.selected(scene.motion.is_magnified())
    phasors = np.einsum("n,knc->kc", share, seen.displacement[:, rows])  # [K, 3]
    order = np.argsort(seen.freqs_hz, kind="stable")
    direction = main_direction(phasors, np.ones(len(phasors)))
    amplitudes = peak_displacement(phasors)
    times = _times(scene.duration, seen.freqs_hz, float(seen.freqs_hz[amplitudes.argmax()]))
    turns = np.exp(2j * np.pi * np.outer(times, seen.freqs_hz))
    along = (turns @ (phasors @ direction)).real
    deviation = None
    if scene.deviation is not None:
        deviation = np.full(len(times), float(np.sqrt(share @ scene.deviation[rows].astype(float) ** 2)))
    return Waveform(
        share @ scene.gaussians.means.numpy()[rows].astype(float),
        direction,
        times,
        along,
        deviation,
        seen.freqs_hz[order],
        amplitudes[order],
    )


def _times(duration: float, frequencies: np.ndarray, main: float) -> np.ndarray:
    """Seconds at which a waveform is drawn: the capture, or the first 12 cycles of its main frequency."""
    end = min(duration, 12.0 / main)
    steps = int(np.clip(16 * end * float(frequencies.max()), 100, 1200))
    return np.linspace(0.0, end, steps + 1)
