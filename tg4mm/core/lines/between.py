"""Pictures that a video codec predicts from both sides lose small motion; where a test says so, they do not count.

A codec stores them more coarsely than those that it predicts forward. What they lose differs from frame to frame and
with the motion's size: a line gets sidebands and a false decay. So each line is tested for having another phasor in
those pictures, by the noise of the others. Where one has, a weaker line that looks like it in the other
pictures is its sideband.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from tg4mm.core.lines.model import Shape, design, refined, solved
from tg4mm.core.lines.record import FEWEST, Record

_SURE = 1e-3  # chance that pictures between others are called lossy though they are not
WEAKER = (
    1.5  # times weaker than the line that it comes of: what a codec makes, if it keeps a tenth of a motion
)
_PLACES = 3  # of pictures between two others, at most, that are told apart


def without_between(
    record: Record, shapes: Sequence[Shape], between: np.ndarray
) -> tuple[Record, list[Shape]] | None:
    """The record of the other pictures alone, and the lines that are there; None where all pictures agree.

    shapes: by falling strength. between [T] bool. Where the others are too few, or cannot tell two of the lines apart,
    they are not taken.
    """
    forward = np.flatnonzero(~between)
    if len(forward) < max(FEWEST, 6 * len(shapes) + 8) or not between.any() or not shapes:
        return None
    part = replace(record, t=record.t[forward], y=record.y[forward])
    sizes = [float(np.linalg.norm(p)) for p in solved(shapes, record.t, record.y)[0]]
    kept: list[int] = []
    for k, s in enumerate(shapes):
        beside = [j for j in kept if _look_alike(part, s, shapes[j])]
        if any(sizes[j] < WEAKER * sizes[k] for j in beside):
            return None
        kept += [] if beside else [k]
    lines = [shapes[k] for k in kept]
    begun = [replace(s, start=int(np.searchsorted(forward, s.start))) for s in lines]
    found = refined(begun, part.t, part.y, part.ends)
    levels = part.levels(found, solved(found, part.t, part.y)[1])
    if not _differ(record, lines, between, [levels[part.bin_of(s.hz, len(levels))] for s in found]):
        return None
    return part, found


def _look_alike(part: Record, a: Shape, b: Shape) -> bool:
    """Whether the other pictures by themselves cannot tell two lines apart."""
    return abs(part.folded(a.hz) - part.folded(b.hz)) < max(
        1 / float(np.ptp(part.t)), abs(a.decay) / (2 * np.pi)
    )


def _differ(
    record: Record, shapes: Sequence[Shape], between: np.ndarray, levels: Sequence[np.ndarray]
) -> bool:
    """Whether any of the lines has another phasor in the pictures between; levels [D] of noise at each."""
    x = design(shapes, record.t)
    return any(
        _explained(record, x, own := _own(record, s, between), levels[k])
        > chi2.isf(_SURE / len(shapes), own.shape[1] * record.y.shape[1])
        for k, s in enumerate(shapes)
    )


def _explained(record: Record, x: np.ndarray, more: np.ndarray, level: np.ndarray) -> float:
    """χ²."""
    before, after = _left(record, x), _left(record, np.column_stack([x, more]))
    return float((((before**2).sum(0) - (after**2).sum(0)) / level).sum())


def _own(record: Record, shape: Shape, between: np.ndarray) -> np.ndarray:
    """[T, P] a line in the first, the second, … picture between two others, and as that changes over the record."""
    last = np.maximum.accumulate(np.where(between, -1, np.arange(len(between))))
    place = np.minimum(np.arange(len(between)) - last, _PLACES) * between
    wave, slow = shape.wave(record.t), (record.t - record.t.mean()) / np.ptp(record.t)
    waves = [
        wave * (place == k) * s for k in range(1, _PLACES + 1) if (place == k).any() for s in (1.0, slow)
    ]
    return np.column_stack([part for w in waves for part in (w.real, w.imag)])


def _left(record: Record, x: np.ndarray) -> np.ndarray:
    return np.asarray(record.y - x @ np.linalg.lstsq(x, record.y, rcond=None)[0])
