"""A vibration's line: frequency, damping and phasors from the run's motion over time; how sure each mode is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.core.lines import FEWEST, Line, find_lines, fit_lines, projected
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import CLEAR_PERIODS
from tg4mm.show.result.model import Length, with_deviation

_SURE = 2.0  # deviations that a frequency is from 0 Hz, else it is a drift
_FREE = 8  # samples beside four for each line that a fit needs


def line_near(
    series: np.ndarray,
    fps: float,
    hz: float,
    others: Sequence[float],
    noise: float,
    between: np.ndarray | None = None,
) -> Line | None:
    """The line of a series [T] that a mode at `hz` belongs to; None where the record is too short to tell.

    others: frequencies of other vibrations. noise: standard deviation of the series' noise over its rms, at least.
    between [T] bool: frames that the codec predicts from both sides.
    """
    n = len(series)
    times = np.arange(n) / fps
    least = noise * float(np.sqrt((series**2).mean()))
    if n < max(FEWEST, 4 * (1 + len(others)) + _FREE):
        return None
    near = [
        (abs(line.hz - hz), line)
        for line in find_lines(series, times, least, between=between).lines
        if abs(line.hz - hz) < max(fps / n, abs(line.decay_per_s) / np.pi)
    ]
    if near:
        return min(near, key=lambda pair: pair[0])[1]
    return fit_lines(series, times, [hz, *others], least).lines[0]


def phasors_at(motion: ModalMotion, line: Line, between: np.ndarray | None = None) -> np.ndarray:
    """[N, 3] of every Gaussian where the line is largest, scene units: the modes' own series, fitted by the line."""
    some = np.arange(motion.n_timesteps)
    some = some if between is None else some[~between]
    gains = np.stack([motion.gains_at(int(t)) for t in some])  # [T, K]
    real, imaginary = np.split(
        projected([line], np.hstack([gains.real, gains.imag]), some / motion.fps)[0], 2
    )
    along = np.tensordot(real.astype(np.complex64), motion.displacement.real, 1)
    return np.asarray(along - np.tensordot(imaginary.astype(np.complex64), motion.displacement.imag, 1))


def why_no_damping(line: Line | None) -> str:
    """In words; "" where there is a damping ratio."""
    if line is None:
        return "the record is too short"
    if line.damping is not None:
        return ""
    words = {
        "steady": "the amplitude stays constant during the record",
        "grows": "the amplitude grows during the record",
        "varies": "the amplitude rises and falls during the record",
        "begins": "the vibration begins during the record and lasts",
    }
    return words.get(line.change, "noise hides whether the amplitude decays during the record")


def mode_deviations(motion: ModalMotion, deviation: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """[K, N] float32 scene units: standard deviation of each mode's amplitude at each Gaussian.

    deviation, noise [N]: of the displacement, rms over time, root of the sum over x, y, z, in all and by noise alone
    (RUN/uncertainty.safetensors). How an error spreads over frequencies is not known. Noise is taken to lie at this one
    as a whole, which is the most it can be; errors of the model, which grow with the motion, by the mode's share of the
    motion's power. A sinusoid's amplitude is √2 times its rms.
    """
    power = (np.abs(motion.displacement) ** 2).sum(2).mean(1).astype(np.float64)
    total = float(power[np.asarray(motion.freqs_hz) > 0].sum())
    share = np.clip(power / total, 0, 1) if total > 0 else np.zeros_like(power)
    by_noise = np.asarray(noise, np.float64) ** 2
    by_model = np.maximum(np.asarray(deviation, np.float64) ** 2 - by_noise, 0)
    return np.sqrt(2 * (by_noise + share[:, None] * by_model)).astype(np.float32)


def series_of(motion: ModalMotion, phasors: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[T] the motion over time along the shape of a mode, in units of its largest displacement at each Gaussian.

    The shape is the real part of the phasors [N, 3] at the time when they are largest; weights [N].
    """
    turned = phasors * np.exp(-0.5j * np.angle(np.einsum("nc,nc,n->", phasors, phasors, weights)))
    shape = weights[:, None] * turned.real
    along = np.einsum("knc,nc->k", motion.displacement, shape) / max(
        float((shape * turned.real).sum()), 1e-30
    )
    gains = np.stack([motion.gains_at(t) for t in range(motion.n_timesteps)], 1)
    return np.asarray((along[:, None] * gains).real.sum(0))


@dataclass(frozen=True)
class Peak:
    """A peak of the modes, and the line that it belongs to."""

    mode_hz: float
    hz: float
    deviation_hz: float
    line: Line | None  # None: the record is too short, or the fit is of steady lines alone
    is_steady: bool = False

    def reach(self, duration_s: float) -> float:
        """Hz to either side that are its own: 1 / duration, or the width of what rings down."""
        return max(1 / duration_s, 0.0 if self.line is None else abs(self.line.decay_per_s) / np.pi)


def is_drift(found: Peak, duration_s: float) -> bool:
    """Whether the record holds too little of a frequency to tell it from a slow drift."""
    return found.mode_hz * duration_s < CLEAR_PERIODS or found.hz < _SURE * found.deviation_hz


def drift_line(drifts: list[Peak], duration_s: float) -> list[str]:
    """A line on the strongest peak that is taken for a drift."""
    return [
        f"whether something vibrates at {with_deviation(Length(v.hz, v.deviation_hz))} Hz or drifts: the record holds "
        f"{v.hz * duration_s:.2g} periods of it; a longer one tells"
        for v in drifts[:1]
    ]
