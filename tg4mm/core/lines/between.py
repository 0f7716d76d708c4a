"""Pictures that a video codec predicts from both sides lose small motion, so a line's numbers are the others'.

A codec stores them more coarsely than those that it predicts forward. What they lose differs from frame to frame and
with the motion's size: amplitudes come out too small, a line gets sidebands and a false decay. A loss that is as large
as the deviation cannot be seen: a test of it has less power than the bias needs to spoil the number. So frequency,
decay and phasor of a line are those of the other pictures wherever these can tell it; lines are looked for in all.

Each line is also tested for having another phasor in those pictures, by the noise of the others. Where one has, a
weaker line that looks like it in the other pictures is its sideband, and what the others do not show is none.
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
_MIRROR, _OVERLAP = 2.0, 0.7  # 1 / duration about twice a frequency, and what is too much there
_PLACES = 3  # of pictures between two others, at most, that are told apart


def without_between(
    record: Record, shapes: Sequence[Shape], between: np.ndarray
) -> tuple[Record, list[Shape], bool] | None:
    """The record of the other pictures alone, the lines that are there, and whether the pictures between differ.

    shapes: by falling strength. between [T] bool. None where all pictures count: the others are too few, or cannot tell
    a line from its mirror image, or from another of which nothing says that one is a sideband.
    """
    forward = np.flatnonzero(~between)
    if len(forward) < max(FEWEST, 6 * len(shapes) + 8) or not between.any() or not shapes:
        return None
    part = replace(record, t=record.t[forward], y=record.y[forward])
    if any(_mirrored(part.t, s.hz) for s in shapes):
        return None
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
    differ = _differ(record, lines, between, [levels[part.bin_of(s.hz, len(levels))] for s in found])
    if not differ and len(lines) < len(shapes):
        return None
    return part, found, differ


def _mirrored(t: np.ndarray, hz: float) -> bool:
    """Whether at times [T] a frequency is hardly told from minus itself: near half the rate of even ones."""
    off = np.linspace(-_MIRROR, _MIRROR, 17) / float(np.ptp(t))
    overlap = np.abs(np.exp(4j * np.pi * (hz + off / 2)[:, None] * (t - t[0])).mean(1))
    return bool(overlap.max() > _OVERLAP)


def _look_alike(part: Record, a: Shape, b: Shape) -> bool:
    """Whether the other pictures by themselves cannot tell two lines apart."""
    return abs(part.folded(a.hz) - part.folded(b.hz)) < max(
        1 / float(np.ptp(part.t)), abs(a.decay) / (2 * np.pi)
    )


def _differ(
    record: Record, shapes: Sequence[Shape], between: np.ndarray, levels: Sequence[np.ndarray]
) -> bool:
    """Whether any of the lines has another phasor in the pictures between; levels [D] of noise at each.

    Two tests share the chance: one gain of all those pictures and components, what a low-pass does; and any phasor for
    each place between two others, as it changes over the record.
    """
    x = design(shapes, record.t)
    chance = _SURE / (2 * len(shapes))
    phasors = solved(shapes, record.t, record.y)[0]
    for s, phasor, level in zip(shapes, phasors, levels, strict=True):
        if _gained(record, x, (s.wave(record.t) * between)[:, None] * phasor, level) > chi2.isf(chance, 2):
            return True
        own = _own(record, s, between)
        if _explained(record, x, own, level) > chi2.isf(chance, own.shape[1] * record.y.shape[1]):
            return True
    return False


def _gained(record: Record, x: np.ndarray, part: np.ndarray, level: np.ndarray) -> float:
    """χ² of one complex gain of a part [T, D] of a line, beside the columns x [T, P] of each component."""
    basis = np.linalg.qr(x)[0]
    columns = np.stack([part.real, -part.imag], -1)  # [T, D, 2]
    columns = (columns - np.einsum("tp,pdk->tdk", basis, np.einsum("tp,tdk->pdk", basis, columns))) / np.sqrt(
        level
    )[:, None]
    y = (record.y / np.sqrt(level)).ravel()
    flat = columns.reshape(-1, 2)
    products = flat.T @ y
    return float(products @ np.linalg.pinv(flat.T @ flat, hermitian=True) @ products)


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
