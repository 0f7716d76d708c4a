"""Rows that are read one after another: readout time by phases or by light, and the time of each row.

By phases: cells that move alike at f Hz, at h of the picture's height from its top, are read T h later, so that their
phases are ahead by 2π f T h. So are those of parts that move one after another, which cannot be distinguished. By
light: of lamps on the mains, which flicker at F = 100 or 120 Hz, a row's brightness at the alias of F is ahead by 2π F
T h.
"""

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np

from tg4mm.capture.look.model import LookSummary, Readout
from tg4mm.capture.look.spectra import step

_Some = TypeVar("_Some", bound=LookSummary)
_MOST_S, _STEPS = 0.045, 181
_GAIN = 8.0  # of log likelihood over rows that are read at once
_SHARE = 0.05  # of a readout by phases, as codecs and edges turn them
_FEWEST_HEIGHTS = 4
_MAINS = (100.0, 120.0)  # Hz of light, twice that of the mains
_DRIFT_HZ = np.linspace(-0.2, 0.2, 9)  # of the light
_STANDS = 1.5  # periods of the alias in the record: fewer cannot be distinguished from shadow
_CLEAR = 8.0  # amplitude over its deviation: 4.4 at most where there is none, 20 at least where there is
_LEAST_S = 0.004  # rolling shutters take 8 to 25 ms; less may be phases of the scene's own


def by_phases(angles: np.ndarray, weights: np.ndarray, heights: np.ndarray, hz: float) -> Readout | None:
    """Return the readout that makes the phases of cells [C] alike, modulo half a turn; None if none is likelier.

    weights [C]: 1 / variance of an angle. heights [C]: 0 at the upper edge, 1 at the lower.
    """
    places = np.unique(heights)
    if len(places) < _FEWEST_HEIGHTS:
        return None
    turned = weights * np.exp(2j * angles)
    tried = np.linspace(-_MOST_S, _MOST_S, _STEPS)
    likely = np.abs(np.exp(-4j * np.pi * hz * np.outer(tried, heights)) @ turned)
    best = int(likely.argmax())
    if best in (0, len(tried) - 1) or (likely[best] - likely[len(tried) // 2]) / 2 < _GAIN:
        return None

    def fitted(chosen: np.ndarray) -> tuple[float, float, float]:
        """Return seconds, their variance by the weights, and χ² per degree of freedom."""
        left = turned[chosen] * np.exp(-4j * np.pi * hz * tried[best] * heights[chosen])
        off = np.angle(left * np.conj(left.sum())) / 2
        columns = np.stack([np.ones(len(off)), 2 * np.pi * hz * heights[chosen]], 1)
        inverse = np.linalg.inv(columns.T @ (weights[chosen, None] * columns))
        fit = inverse @ (columns.T @ (weights[chosen] * off))
        spread = float(weights[chosen] @ (off - columns @ fit) ** 2) / max(len(off) - 2, 1)
        return float(tried[best] + fit[1]), float(inverse[1, 1]), spread

    seconds, variance, spread = fitted(np.ones(len(heights), bool))
    without = np.array([fitted(heights != place)[0] for place in places])
    scatter = (len(places) - 1) * float(np.var(without))  # jackknife: neighbours of one height err alike
    total = max(variance * max(spread, 1.0), scatter)
    return Readout(seconds, float(np.hypot(total**0.5, _SHARE * seconds)))


def by_light(rows: np.ndarray, times_s: np.ndarray) -> Readout | None:
    """Return the readout from the phase of lamp flicker over rows; None if no flicker stands out.

    rows [F, H]: mean grey levels of every row.
    """
    n, height = rows.shape
    rate, heights = 1 / step(times_s), (np.arange(height) + 0.5) / height
    light = np.log(np.maximum(rows, 1.0))
    light = (light - light.mean(0)) * 2 * np.hanning(n)[:, None]
    found: list[tuple[float, float, Readout]] = []
    for mains in _MAINS:
        alias = (mains + rate / 2) % rate - rate / 2
        if abs(alias) * n / rate < _STANDS:
            continue
        cycles = np.outer(_DRIFT_HZ + alias, times_s)
        waves = 2 / n * np.exp(-2j * np.pi * cycles) @ light  # [D, H]
        tried = np.linspace(-1 / rate, 1 / rate, 1601)
        size = np.abs(waves @ np.exp(-2j * np.pi * mains * np.outer(heights, tried))) / height
        drift, best = np.unravel_index(int(size.argmax()), size.shape)
        turned = waves[drift] * np.exp(-2j * np.pi * mains * tried[best] * heights)
        mean = turned.mean()
        if mean == 0:  # dark
            continue
        columns = np.stack([np.ones(height), 2 * np.pi * mains * heights], 1)
        off = np.imag(turned / mean)
        fit = np.linalg.lstsq(columns, off, rcond=None)[0]
        left = off - columns @ fit
        alike = max(float((left[1:] * left[:-1]).mean() / max((left**2).mean(), 1e-30)), 0.0)
        fewer = (1 + alike) / (1 - alike + 1e-9)  # neighbouring rows err alike
        variance = left @ left / max(height - 2, 1) * fewer * np.linalg.inv(columns.T @ columns)[1, 1]
        noise = float((np.abs(turned - mean) ** 2).mean()) * fewer / height
        seconds = float(tried[best] + fit[1])
        found.append((abs(mean) / (noise**0.5 + 1e-30), abs(alias), Readout(seconds, variance**0.5, mains)))
    found.sort(key=lambda each: -each[0])
    if len(found) == 2 and abs(found[0][1] - found[1][1]) < 2 * _STANDS * rate / n:
        return None  # either lamp explains it
    return found[0][2] if found and found[0][0] > _CLEAR else None


def with_rows(found: _Some, readout_s: float) -> _Some:
    """Return the result for a picture read over `readout_s`: phases are by the clock of its middle row."""
    height = found.size[1]
    lines = tuple(
        replace(
            line,
            phase_rad=line.phase_rad - 2 * np.pi * line.hz * readout_s * (line.centre_px[1] / height - 0.5),
        )
        for line in found.lines
    )
    return replace(found, lines=lines, rows_s=readout_s)


def readout_of(found: LookSummary) -> Readout | None:
    """Return the readout from light, else the weighted mean over lines without a mark; None if unknown."""
    if found.light_readout is not None:
        return found.light_readout
    estimates = [
        (line.readout_s, line.readout_deviation_s**2)
        for line in found.vibrations
        if line.readout_s is not None and line.readout_deviation_s
    ]
    if not estimates:
        return None
    seconds, variances = np.array(estimates).T
    variance = 1 / (1 / variances).sum()
    mean = variance * (seconds / variances).sum()
    spread = float(((seconds - mean) ** 2 / variances).sum()) / max(len(estimates) - 1, 1)
    return Readout(float(mean), float((variance * max(spread, 1.0)) ** 0.5))


def row_note(found: LookSummary) -> str:
    """Return a note on phases at different heights and the option that would explain them; empty if consistent."""
    estimate = readout_of(found)
    if estimate is None or abs(estimate.seconds - found.rows_s) < max(_LEAST_S, 2 * estimate.deviation_s):
        return ""
    ms, deviation, frame_s = 1e3 * estimate.seconds, 1e3 * estimate.deviation_s, 1 / (2 * float(found.hz[-1]))
    more = " other than the readout that was given" if found.rows_s else ""
    if estimate.seconds < -2 * estimate.deviation_s or estimate.seconds > frame_s + 2 * estimate.deviation_s:
        return (
            f"phases at different heights: they rise with the row as if a picture were read over {ms:.3g} ± "
            f"{deviation:.2g} ms, which no readout of 0 to {1e3 * frame_s:.4g} ms from top to bottom explains"
        )
    digits = max(0, 1 - math.floor(math.log10(max(deviation, 1e-3))))
    what = f"--readout {ms:.{digits}f} would explain it, ± {deviation:.2g} ms"
    if estimate.light_hz:
        return (
            f"phases at different heights to better than the readout{more}: dark bands run over the picture; "
            f"{what}, if lamps flicker at {estimate.light_hz:g} Hz"
        )
    return (
        f"phases at different heights to better than the readout{more}: they rise with the row; {what}, if what "
        "vibrates moves at the same time at all heights"
    )
