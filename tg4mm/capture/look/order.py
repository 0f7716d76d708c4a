"""A line's frequency where the frames between two predicted ones keep different shares of its motion.

Frames of each position have other losses. With a period of n frames these give a line at f an image at
|k rate / n ± f|, which a short record may not resolve from the line: 3.8 Hz beside 3.7 Hz at 30 Hz with three B-frames
in a row. One sinusoid for all frames then has a false frequency. So each position gets a phasor, beside a common
frequency.
"""

from typing import NamedTuple

import numpy as np

from tg4mm.capture.look.scene import FEWEST_OF_KIND, position_in_row

_STEPS = 8
_CONVERGED = 1e-4  # cycles over the record
_MORE = 2.0  # times the others' amplitude: what B-frames show more of is not attenuated in them


class AlikeSeries(NamedTuple):
    """A series in which frames of each position show a line as the others do."""

    series: np.ndarray  # [F]
    hz: float
    wider: float  # times the variance of the frequency with one phasor for all positions


def alike_by_position(series: np.ndarray, times_s: np.ndarray, kinds: np.ndarray, hz: float) -> AlikeSeries:
    """Fit a line near `hz` to a series [F] with a phasor for each position in a row of B-frames, and equalise these.

    kinds [F]: of the frames, as in `CellSeries`. Frames that are not B, and positions with few frames, share a phasor.
    """
    apart = positions_apart(kinds)
    if apart.shape[1] == 1:
        return AlikeSeries(series, hz, 1.0)
    away = times_s - times_s.mean()
    slow = np.stack([away**k for k in range(3)], 1)
    span, found = float(np.ptp(times_s)), hz
    for _ in range(_STEPS):
        wave = np.exp(2j * np.pi * found * away)
        residual, phasors, slope = _solved(series, wave, apart, slow, away)
        by = float(slope @ residual / max(slope @ slope, 1e-300))
        found += float(np.clip(by, -0.5 / span, 0.5 / span))
        if abs(by) * span < _CONVERGED:
            break
    wave = np.exp(2j * np.pi * found * away)
    _, phasors, slope = _solved(series, wave, apart, slow, away)
    if abs(found - hz) * span > 1 or (np.abs(phasors) > _MORE * abs(phasors[0])).any():
        return AlikeSeries(series, hz, 1.0)
    together = _solved(series, wave, np.ones((len(series), 1), bool), slow, away)[2]
    wider = max(float(together @ together / max(slope @ slope, 1e-300)), 1.0)
    mean = apart.mean(0) @ phasors
    return AlikeSeries(series + (wave * (apart @ (mean - phasors))).real, found, wider)


def positions_apart(kinds: np.ndarray) -> np.ndarray:
    """[F, n] bool: frames that are not B or of positions with few frames, then those of each other position."""
    position = position_in_row(kinds)
    enough = [k for k in range(1, int(position.max()) + 1) if (position == k).sum() >= FEWEST_OF_KIND]
    return np.stack([~np.isin(position, enough), *(position == k for k in enough)], 1)


def _solved(
    series: np.ndarray, wave: np.ndarray, apart: np.ndarray, slow: np.ndarray, away: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residual [F], the positions' phasors [n], and the derivative by frequency less all other unknowns [F]."""
    columns = np.concatenate([wave.real[:, None] * apart, -wave.imag[:, None] * apart, slow], 1)
    basis, upper = np.linalg.qr(columns)
    weights = np.linalg.lstsq(upper, basis.T @ series, rcond=None)[0]
    n = apart.shape[1]
    phasors = weights[:n] + 1j * weights[n : 2 * n]
    by_hz = (2j * np.pi * away * wave * (apart @ phasors)).real
    return series - basis @ (basis.T @ series), phasors, by_hz - basis @ (basis.T @ by_hz)
