"""Candidates for the next line: matched filters of every frequency, decay and beginning, over the noise level.

For noise alone a filter's statistic Σ_d |Σ_t r_d e exp(−iωt)|² / (S_d Σ_t e²) is a sum of exponentially distributed
parts, one for each component. Of all significant candidates the one with most power is chosen, since the leakage of a
strong line is significant too.

B-frames of a video lose small motion: a codec stores them more coarsely than P-frames. The loss varies between frames
and with the motion's size: amplitudes are too small, a line gets sidebands and a false decay. A loss as large as the
deviation cannot be detected: the bias matters before a test has the power to find it. So frequency, decay and phasor of
a line come from the other frames wherever these resolve it; lines are searched for in all frames.

Each line is also tested for a different phasor in B-frames, by the noise of the others. If one differs, a weaker line
that looks like it in the other frames is its sideband, and lines that the others do not show are discarded.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from tg4mm.core.lines.model import LineShape, design, refined, solved
from tg4mm.core.lines.record import FEWEST, Record

_OVERSAMPLED = 4  # frequencies to each 1 / duration
_DECAYS = 0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0  # e-foldings over the record
_GROWTHS = -1.5, -4.0
_BLOCKS = 32  # beginnings that are tried
# of a filter's energy; periods also of the record before a beginning
_LEAST_SAMPLES, LEAST_PERIODS = (8.0, 1.0)
_SURE = 1e-3  # chance that pictures between others are called lossy though they are not
# times weaker than the line that it comes of: what a codec makes, if it keeps a tenth of a motion
WEAKER = 1.5
_MIRROR, _OVERLAP = 2.0, 0.7  # 1 / duration about twice a frequency, and what is too much there
_PLACES = 3  # of pictures between two others, at most, that are distinguished


@dataclass(frozen=True)
class LineCandidate:
    """A shape and its statistic."""

    shape: LineShape
    statistic: float
    power: float = 0.0

    def or_better(self, other: "LineCandidate", least: float) -> "LineCandidate":
        """Return the one with more power if that has at least the statistic `least`, else the more significant one."""
        if (self.statistic >= least) != (other.statistic >= least):
            return max(self, other, key=lambda c: c.statistic)
        key = "power" if self.statistic >= least else "statistic"
        return max(self, other, key=lambda c: float(getattr(c, key)))


def candidates(
    residual: np.ndarray,
    t: np.ndarray,
    levels: np.ndarray,
    lines: Sequence[LineShape],
    ends: tuple[float, float],
    least: float,
) -> list[LineCandidate]:
    """Return the best steady, the best decaying or growing and the best beginning line in a residual [T, D].

    levels [F, D] at the bins of the record; least: statistic from which on power decides. A frequency that is nearer to
    one of the lines than half of 1 / duration, than 1 / (the filter's own duration), or than the line is wide, is none.
    """
    look = _Look.of(residual, t, levels, lines, ends, least)
    if not len(look.hz):
        return []
    return [look.all_along([0.0]), look.all_along([*_DECAYS[1:], *_GROWTHS]), look.beginning()]


def strongest(
    residual: np.ndarray,
    t: np.ndarray,
    levels: np.ndarray,
    lines: Sequence[LineShape],
    ends: tuple[float, float],
) -> LineShape:
    """Return the steady line of most power, whether or not it stands out; arguments as of `candidates`."""
    return _Look.of(residual, t, levels, lines, ends, 0.0).all_along([0.0]).shape


@dataclass(frozen=True)
class _Look:
    """The parts that all filters of one residual share."""

    residual: np.ndarray  # [T, D]
    t: np.ndarray
    step: float  # s
    hz: np.ndarray  # [F]
    turned: np.ndarray  # [2, F, T] Re and Im of exp(−iωt)
    level: np.ndarray  # [F, D]
    away: np.ndarray  # [F] Hz to the nearest line; −1 within the width of one
    least: float

    @staticmethod
    def of(
        residual: np.ndarray,
        t: np.ndarray,
        levels: np.ndarray,
        lines: Sequence[LineShape],
        ends: tuple[float, float],
        least: float,
    ) -> "_Look":
        step = float(np.median(np.diff(t)))
        duration = float(np.ptp(t)) + step
        hz = np.arange(ends[0], ends[1], 1 / (_OVERSAMPLED * duration))
        bins = np.arange(1, len(levels) + 1)
        level = np.stack([np.interp(hz * duration, bins, component) for component in levels.T], 1)
        away = np.full(len(hz), np.inf)
        for s in lines:
            off = np.abs(hz - s.hz)
            away = np.where(off < max(0.5 / duration, abs(s.decay) / np.pi), -1, np.minimum(away, off))
        turned = _turned(hz, t - t[0])
        return _Look(residual, t, step, hz, turned, level, away, least)

    def all_along(self, rates: Sequence[float]) -> LineCandidate:
        """Return the best line over the whole record. rates: e-foldings over it."""
        shapes = [LineShape(0.0, rate / float(np.ptp(self.t))) for rate in rates]
        envelopes = np.stack([shape.envelope(self.t) for shape in shapes], 1)  # [T, R]
        weighted = (self.residual[:, None] * envelopes[..., None]).reshape(len(self.t), -1)
        sums = (self.turned @ weighted).reshape(2, len(self.hz), len(shapes), -1)
        return self._highest(sums, (envelopes**2).sum(0), shapes)

    def beginning(self) -> LineCandidate:
        """Return the best line that begins a period or more into the record, at the first sample of a block."""
        t, best = self.t, LineCandidate(LineShape(0.0), 0.0)
        edges = np.unique(np.linspace(0, len(t), _BLOCKS + 1).astype(int))
        rates = np.array(_DECAYS) / float(np.ptp(t))
        sums = np.zeros((2, len(self.hz), len(rates), self.level.shape[1]))
        energies = np.zeros(len(rates))
        for first, last in zip(edges[-2:0:-1], edges[:1:-1], strict=True):
            rows = slice(first, last)
            e = np.exp(-rates[:, None] * (t[rows] - t[first]))
            carried = np.exp(-rates * (t[last] - t[first])) if last < len(t) else np.zeros(len(rates))
            weighted = (self.residual[rows][:, None] * e.T[..., None]).reshape(last - first, -1)
            sums *= carried[:, None]
            sums += (self.turned[..., rows] @ weighted).reshape(sums.shape)
            energies = (e**2).sum(1) + carried**2 * energies
            shapes = [LineShape(0.0, float(rate), int(first)) for rate in rates]
            best = best.or_better(self._highest(sums, energies, shapes), self.least)
        return best

    def _highest(self, sums: np.ndarray, energies: np.ndarray, shapes: Sequence[LineShape]) -> LineCandidate:
        """The best of R filters by sums [2, F, R, D], Re and Im, and energies [R], at the peak of the power nearby."""
        power = np.einsum("cfrd,cfrd->rfd", sums, sums) / energies[:, None, None]
        lasts, before = energies[:, None] * self.step, self.t[shapes[0].start] - self.t[0]
        allowed = (self.hz * lasts >= LEAST_PERIODS) & (energies[:, None] >= _LEAST_SAMPLES)
        allowed &= self.away > np.where(lasts > 0.5 * np.ptp(self.t), 0.5, 1) / lasts
        if before:
            allowed &= self.hz * before >= LEAST_PERIODS
        if not allowed.any():
            return LineCandidate(shapes[0], 0.0)
        statistic = np.where(allowed, np.einsum("rfd,fd->rf", power, 1 / self.level), 0.0)
        total = power @ (1 / self.level.mean(0))
        stands_out = statistic >= self.least
        best = int((np.where(stands_out, total, 0) if stands_out.any() else statistic).argmax())
        k, at = divmod(best, len(self.hz))
        first = max(at - _OVERSAMPLED, 0)
        near = power[k, first : at + _OVERSAMPLED + 1]
        peak = first + int((near / self.level[at]).sum(1).argmax())
        hz = float(self.hz[peak if allowed[k, peak] else at])
        shape = replace(shapes[k], hz=hz)
        return LineCandidate(shape, float(statistic[k, at]), float(total[k, at]))


def _turned(hz: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return [2, F, T]: exp(−iωt) at evenly spaced frequencies, each a product of two exponentials, to save time."""
    few = int(np.sqrt(len(hz))) + 1
    coarse, fine = (
        np.exp(-2j * np.pi * frequencies[:, None] * t) for frequencies in (hz[::few], hz[:few] - hz[:1])
    )
    turned = (coarse[:, None] * fine).reshape(-1, len(t))[: len(hz)]
    return np.stack([turned.real, turned.imag])


def without_between(
    record: Record, shapes: Sequence[LineShape], b_frames: np.ndarray
) -> tuple[Record, list[LineShape], bool] | None:
    """Return the record without B-frames, its lines, and whether the B-frames differ from it.

    shapes: by falling strength. b_frames [T] bool. None where all pictures count: the others are too few, or cannot
    separate a line from its mirror image, or from another where nothing shows that one is a sideband.
    """
    forward = np.flatnonzero(~b_frames)
    if len(forward) < max(FEWEST, 6 * len(shapes) + 8) or not b_frames.any() or not shapes:
        return None
    part = replace(record, t=record.t[forward], y=record.y[forward])
    if any(mirrored(part.t, s.hz) for s in shapes):
        return None
    sizes = [float(np.linalg.norm(p)) for p in solved(shapes, record.t, record.y)[0]]
    kept: list[int] = []
    for k, s in enumerate(shapes):
        beside = [j for j in kept if _look_alike(part, s, shapes[j])]
        if any(sizes[j] < WEAKER * sizes[k] for j in beside):
            return None
        kept += [] if beside else [k]
    begun = {k: _part_of(shapes[k], forward) for k in kept}
    found = refined(list(begun.values()), part.t, part.y, part.ends)
    while gone := [k for k in range(len(found)) if _has_strayed(part, list(begun.values()), found, k)]:
        begun.pop(list(begun)[gone[-1]])
        found = refined(list(begun.values()), part.t, part.y, part.ends)
    lines = [shapes[k] for k in begun]
    levels = part.levels(found, solved(found, part.t, part.y)[1])
    differ = _differ(record, lines, b_frames, [levels[part.bin_of(s.hz, len(levels))] for s in found])
    if not differ and len(lines) < len(shapes):
        return None
    return part, found, differ


def _has_strayed(part: Record, begun: Sequence[LineShape], found: Sequence[LineShape], k: int) -> bool:
    """Return whether line k, refined in the other pictures, left its frequency, or is an alias of a stronger one."""
    width = max(1 / float(np.ptp(part.t)), abs(begun[k].decay) / (2 * np.pi))
    is_alias = any(_look_alike(part, found[k], stronger) for stronger in found[:k])
    return is_alias or (k > 0 and abs(found[k].hz - begun[k].hz) > width)


def _part_of(shape: LineShape, forward: np.ndarray) -> LineShape:
    """The shape in those samples of its record alone."""
    modulation = None if shape.modulation is None else shape.modulation[forward]
    return replace(shape, start=int(np.searchsorted(forward, shape.start)), modulation=modulation)


def mirrored(t: np.ndarray, hz: float) -> bool:
    """Return whether times [T] hardly resolve a frequency from its negative, as even ones do near half their rate."""
    off = np.linspace(-_MIRROR, _MIRROR, 17) / float(np.ptp(t))
    overlap = np.abs(np.exp(4j * np.pi * (hz + off / 2)[:, None] * (t - t[0])).mean(1))
    return bool(overlap.max() > _OVERLAP)


def _look_alike(part: Record, a: LineShape, b: LineShape) -> bool:
    """Return whether the other pictures alone do not resolve two lines."""
    return abs(part.folded(a.hz) - part.folded(b.hz)) < max(
        1 / float(np.ptp(part.t)), abs(a.decay) / (2 * np.pi)
    )


def _differ(
    record: Record, shapes: Sequence[LineShape], b_frames: np.ndarray, levels: Sequence[np.ndarray]
) -> bool:
    """Return whether any line has a different phasor in the B-frames; levels [D] of noise at each.

    Two tests share the chance of a false alarm: one gain for all B-frames and components, as by a low-pass; and a free
    phasor for each position between two other frames.
    """
    x = design(shapes, record.t)
    chance = _SURE / (2 * len(shapes))
    phasors = solved(shapes, record.t, record.y)[0]
    for s, phasor, level in zip(shapes, phasors, levels, strict=True):
        if _gained(record, x, (s.wave(record.t) * b_frames)[:, None] * phasor, level) > chi2.isf(chance, 2):
            return True
        part = _own(record, s, b_frames)
        if _explained(record, x, part, level) > chi2.isf(chance, part.shape[1] * record.y.shape[1]):
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
    before, after = _left(record, x), _left(record, np.column_stack([x, more]))
    return float((((before**2).sum(0) - (after**2).sum(0)) / level).sum())


def _own(record: Record, shape: LineShape, b_frames: np.ndarray) -> np.ndarray:
    """Return [T, P]: a line in the first, second, … B-frame between two other frames, also changing over the record."""
    last = np.maximum.accumulate(np.where(b_frames, -1, np.arange(len(b_frames))))
    place = np.minimum(np.arange(len(b_frames)) - last, _PLACES) * b_frames
    wave, slow = shape.wave(record.t), (record.t - record.t.mean()) / np.ptp(record.t)
    waves = [
        wave * (place == k) * s for k in range(1, _PLACES + 1) if (place == k).any() for s in (1.0, slow)
    ]
    return np.column_stack([part for w in waves for part in (w.real, w.imag)])


def _left(record: Record, x: np.ndarray) -> np.ndarray:
    return np.asarray(record.y - x @ np.linalg.lstsq(x, record.y, rcond=None)[0])
