"""Suggestions for a result: a band around each frequency, a magnification that shows the motion, a command line."""

import math
import shlex
from collections.abc import Sequence

from tg4mm.capture import Capture
from tg4mm.capture.transforms import SPLITS
from tg4mm.run import Run
from tg4mm.show.result.model import Band, Vibration
from tg4mm.show.result.reading import MagnificationLimits

_SHOWN = 0.04  # share of the picture's shorter side that is easy to see
_STEPS = (1.0, 2.0, 5.0)
_MOST, _DEFAULT = 500.0, 20.0
_ORBIT = 90  # pictures
_MANY = 60  # cameras; rendering more of the training split takes hours
_DEVIATIONS = 3.0


def suggested_alpha(limits: MagnificationLimits | None, capture: Capture | None) -> float:
    """Return a round α (1, 2, 5, 10 …) at which the motion is easy to see and within its limits.

    It is the default of result, report, viewer and page: the largest motion spans 4 % of the picture's shorter side,
    which is visible at once and keeps shapes intact; less if noise became visible or parts tore.

    reach: of the unmagnified motion.
    """
    if limits is None or limits.pixels is None or capture is None:
        return _DEFAULT
    wanted = 1 + _DEFAULT
    if limits.pixels > 0:
        wanted = _SHOWN * min(capture.width, capture.height) / limits.pixels
    most = min(wanted, 1 / limits.too_far if limits.too_far > 0 else _MOST, _MOST + 1) - 1
    round_ones = [step * 10**power for power in range(3) for step in _STEPS]
    return max((a for a in round_ones if a <= max(most, 1.0)), default=1.0)


def next_command(run: Run, capture: Capture | None, vibrations: Sequence[Vibration], alpha: float) -> str:
    """Return a `tg4mm render` command line for the strongest vibration, or without one for the scene at rest."""
    out = run.path.with_name(f"{run.path.name}_x{alpha:g}" if vibrations else f"{run.path.name}_rest")
    parts = ["tg4mm", "render", str(run.path), "--alpha", f"{alpha if vibrations else 0:g}"]
    if vibrations:
        parts += ["--band", *(f"{f:g}" for f in vibrations[0].band)]
    return shlex.join([*parts, *_cameras(capture), "--out", str(out)])


def _cameras(capture: Capture | None) -> list[str]:
    """Return options for the test cameras if there are any, for few training cameras, otherwise for an orbit."""
    if capture is None:
        return ["--orbit", str(_ORBIT)]
    if any(next(capture.root.glob(f"{where}transforms_{SPLITS[1]}.json"), None) for where in ("", "000*/")):
        return []
    few = len(set(capture.camera_ids.tolist())) <= _MANY and capture.kind.seen_by_train
    return ["--split", "train"] if few else ["--orbit", str(_ORBIT)]


def suggested_bands(
    hz: Sequence[float],
    deviations_hz: Sequence[float],
    duration_s: float,
    fps: float,
    half_widths_hz: Sequence[float] | None = None,
) -> list[Band]:
    """Return a band for each of the frequencies [K], in order, that contains none of the others.

    It reaches one step of the record's resolution, 1 / duration, to either side, as a sinusoid's bins do; further for
    lines that ring down (`half_widths_hz`) and for frequencies with a deviation over a third of that. It ends half-way
    to the next frequency, above 0 Hz and below half the frame rate, at round numbers.
    """
    out = []
    for f, deviation, width in zip(hz, deviations_hz, half_widths_hz or [0.0] * len(hz), strict=True):
        half = max(1 / duration_s, width, _DEVIATIONS * deviation)
        low = max([f - half, 0.5 / duration_s, *((f + other) / 2 for other in hz if other < f)])
        high = min([f + half, 0.999 * fps / 2, *((f + other) / 2 for other in hz if other > f)])
        out.append(_rounded(low, high, f))
    return out


def _rounded(low: float, high: float, f: float) -> Band:
    """Return ends with as few digits as a twentieth of the band allows, moved inwards around the frequency."""
    digits = max(0, math.ceil(-math.log10((high - low) / 20)))
    scale = 10.0**digits
    inner = math.ceil(round(low * scale, 6)) / scale, math.floor(round(high * scale, 6)) / scale
    return inner if inner[0] < f < inner[1] else (low, high)
