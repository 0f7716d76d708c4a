"""Detection of lines: one after the other, each tested, all fitted together.

A line enters as the simplest adequate model: steady; decaying or growing if that explains more, by a likelihood-ratio
test; beginning in the record if that does. So a decaying vibration is one line instead of several steady ones. Near a
stronger line, a modulation of that line (`modulation.py`) competes with a new line. Two lines nearer than 1 / duration
need a separate test. In a long record, such as an accelerometer's, lines are the peaks of its spectrum.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import find_peaks
from scipy.stats import chi2, gamma
from scipy.stats import f as f_distribution

from tg4mm.core.lines.model import AROUND, TREND, LineShape, level, refined, samples, solved, spectra
from tg4mm.core.lines.modulation import modulated, reach, unknowns
from tg4mm.core.lines.record import (
    LEAST_CHANGE,
    LEAST_CYCLES,
    LONG,
    CodecChange,
    Line,
    Lines,
    Record,
    covariances,
    nothing,
    wald,
)
from tg4mm.core.lines.search import LEAST_PERIODS, LineCandidate, candidates, strongest, without_between

_TRIED = 6.0  # independent frequencies, decays and beginnings to each sample
_EACH, _BESIDE = 4, 6  # samples for each line, and beside them
_SURE = 1e-3  # chance of a decay, or a beginning, that is none
# bins of a spectrum that one line's side lobes fill; times what noise makes a line be that they hide in a longer one
_FEW_BINS, _CLEAR = 24, 4.0
_LEAST_SIZE = 0.02  # of the strongest line: side lobes that noise left, harmonics of what is not linear


def find_lines(
    values: np.ndarray,
    times_s: np.ndarray,
    noise: np.ndarray | float = 0.0,
    ends: tuple[float, float] | None = None,
    most: int = 8,
    b_frames: np.ndarray | None = None,
    chance: float = 0.01,
    codec: CodecChange | None = None,
) -> Lines:
    """The lines of values [T] or [T, D] at times [T] in seconds, which need not be even.

    noise: standard deviation of each component's samples [D] that is known from elsewhere; the residual's own counts
    where it is larger. ends: the lowest and highest frequency looked at, Hz; 1.5 cycles in the record and half the
    rate less half of 1 / duration if not given. Components share frequencies and decays. chance: that noise alone makes
    a line in the record. Fewer than 12 samples give none. b_frames [T] bool: samples of B-frames; lines are
    searched for in all samples and fitted to the others. codec: the changes of a line that are not reported, as a codec
    may have made them.
    """
    record = Record.of(values, times_s, noise, ends, chance, codec)
    if record is None:
        return nothing(values)
    is_long = len(record.t) > LONG
    shapes = _peaks(record, most) if is_long else []
    for _ in range(0 if is_long else 2 * most):
        more = _with_next(record, shapes)
        if more is None or len(more) > min(most, (len(record.t) - _BESIDE) // _EACH):
            break
        shapes = more
        record = record.whitened(shapes)
    shapes = _kept(record, shapes)
    found = record.result(shapes)
    order = np.argsort([-line.strength for line in found.lines])
    if b_frames is not None and (
        part := without_between(record, [shapes[k] for k in order], np.asarray(b_frames, bool))
    ):
        later, lines_there, differ = part
        lines = later.result(_kept(later, lines_there)).lines
        if not differ:
            lines += tuple(line for line in found.lines if not _is_among(line, lines, later))
        left = found.residual + sum(line.at(record.t) for line in found.lines)
        found = replace(found, lines=lines, residual=left - sum(line.at(record.t) for line in lines))
    strong = sorted(found.lines, key=lambda line: -line.strength)
    return replace(found, lines=tuple(strong))


def _peaks(record: Record, most: int) -> list[LineShape]:
    """Return steady lines at the strongest peaks of a long record's spectrum, through Hann's window."""
    window = np.hanning(len(record.t))[:, None]
    power = np.abs(spectra(record.y * window, record.t)) ** 2 / (window**2).mean()
    ratio = (power / np.maximum(level(power), record.least())).sum(1)
    hz = np.arange(1, len(power) + 1) / (samples(record.t) * float(np.median(np.diff(record.t))))
    power = power.sum(1)
    is_peak = ratio > gamma.isf(record.chance / len(power), record.y.shape[1])
    is_peak &= (hz > record.ends[0]) & (hz < record.ends[1])
    at = [k for k in find_peaks(power)[0] if is_peak[k]]
    at = sorted(at, key=lambda k: -power[k])[:most]
    shapes = [LineShape(float(hz[k])) for k in at if power[k] > _LEAST_SIZE**2 * power[at[0]]]
    return refined(shapes, record.t, record.y, record.ends) if shapes else []


def _is_among(line: Line, lines: Sequence[Line], record: Record) -> bool:
    """Return whether a line is among those fitted to a part of its record."""
    reach = 1 / float(np.ptp(record.t))
    return any(abs(line.hz - other.hz) < max(reach, 3 * other.hz_deviation) for other in lines)


def fit_lines(
    values: np.ndarray,
    times_s: np.ndarray,
    at: Sequence[float] | Sequence[Line] | np.ndarray,
    noise: np.ndarray | float = 0.0,
    codec: CodecChange | None = None,
) -> Lines:
    """One line for each of `at` [K], in their order.

    Frequencies (Hz) are refined, by 0.75 / duration at most, and decay where it is resolved; lines, of another record
    at the same times, keep their frequency and envelope. The other arguments are `find_lines`'. Raises ValueError for
    fewer than 12 samples, or than four for each line and eight.
    """
    record = Record.of(values, times_s, noise, None, codec=codec)
    if record is None or len(record.t) < 4 * len(at) + 8:
        raise ValueError(f"{len(times_s)} samples are too few for {len(at)} lines")
    lines = [line for line in at if isinstance(line, Line)]
    if lines:
        shapes = [_shape_of(line, record.t) for line in lines]
        return record.whitened(shapes).result(shapes)
    shapes = [LineShape(float(hz)) for hz in np.clip(np.asarray(at, np.float64), *record.ends)]
    record = record.whitened(refined(shapes, record.t, record.y, record.ends))
    return record.result(_settled(record, refined(shapes, record.t, record.y, record.ends)))


def fit_line_near(values: np.ndarray, times_s: np.ndarray, hz: float, half_hz: float, noise: float) -> Line:
    """Return the line of one series [T] within `half_hz` of a frequency at which there is one, whatever lies beside it.

    It is steady, rings down from the first sample on, or begins in the record: the simplest that explains the series,
    whose noise has a standard deviation of `noise`. Its own errors are those of what it leaves, as everywhere.
    Raises ValueError for fewer than 12 samples.
    """
    ends = max(hz - half_hz, LEAST_CYCLES / float(np.ptp(times_s))), hz + half_hz
    record = Record.of(values, times_s, noise, ends)
    if record is None:
        raise ValueError(f"{len(times_s)} samples are too few for a line")
    level = np.broadcast_to(noise**2 / record.back[0] ** 2, (1, 1))
    options = [[LineShape(hz)]]
    for c in candidates(record.y, record.t, level, (), ends, 0.0):
        if c.statistic > 0 and c.shape.decay >= 0:
            shape = replace(c.shape, is_free=c.shape.decay != 0)
            options.append([_begun(record, [], shape) if shape.start else shape])
    options = [refined(option, record.t, record.y, ends) for option in options]
    return record.result(_simplest(record, options, level)).lines[0]


def projected(lines: Sequence[Line], values: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Return [K, D] phasors of lines [K] in values [T, D], by least squares beside a slow trend; shapes as they are."""
    shapes = [_shape_of(line, np.asarray(times_s, np.float64)) for line in lines]
    phasors = solved(shapes, np.asarray(times_s, np.float64), np.asarray(values, np.float64))[0]
    turn = [np.exp(-2j * np.pi * s.hz * s.middle_s(np.asarray(times_s))) for s in shapes]
    return np.asarray(phasors * np.array(turn)[:, None])


def _shape_of(line: Line, t: np.ndarray) -> LineShape:
    start = 0 if line.start_s is None else int(np.searchsorted(t, line.start_s - 1e-9))
    return LineShape(line.hz, line.decay_per_s, start)


def _with_next(record: Record, shapes: list[LineShape]) -> list[LineShape] | None:
    """Return the shapes and one more, all refined; None if none is significant."""
    residual = solved(shapes, record.t, record.y)[1]
    floor, freedom = record.floor(residual, shapes)
    width, tried = record.y.shape[1], _TRIED * len(record.t)
    least = width * float(f_distribution.isf(record.chance / tried, 2 * width, freedom))
    found = candidates(residual, record.t, floor, shapes, record.ends, least)
    if not found:
        return None
    if max(c.statistic for c in found) < least:
        hidden = strongest(residual, record.t, floor, shapes, record.ends)
        if not hidden.hz or not _explains(record, shapes, hidden, tried):
            return None
        found = [LineCandidate(hidden, 1.0)]
    options = []
    for c in (c for c in found if c.statistic > 0):
        shape = replace(c.shape, is_free=c.shape.decay != 0)
        if shape.start:
            shape = _begun(record, shapes, shape)
        options.append(refined([*shapes, shape], record.t, record.y, record.ends))
    more = _beginnings(record, _simplest(record, options))
    more = _cheapest(record, [more, *_changing(record, shapes, more)])
    return None if unknowns(more) == unknowns(shapes) and len(more) == len(shapes) else more


def _explains(record: Record, shapes: list[LineShape], shape: LineShape, tried: float) -> bool:
    """Return whether a line exceeds its residual, which may consist of its own side lobes."""
    more = refined([*shapes, shape], record.t, record.y, record.ends)
    phasors, residual = solved(more, record.t, record.y)
    levels, width = record.levels(more, residual), 2 * record.y.shape[1]
    strength = wald(phasors[-1], covariances(record, more, phasors, levels)[-1])
    freedom = max(2 * min(len(levels), 2 * AROUND + 1) - TREND - 3 * len(more), 1)
    least = width * float(f_distribution.isf(record.chance / tried, width, freedom))
    return strength > (1 if len(levels) <= _FEW_BINS else _CLEAR) * least


def _changing(record: Record, shapes: list[LineShape], more: list[LineShape]) -> list[list[LineShape]]:
    """Return alternatives to the newest of `more`: a change of a stronger line near it, or its mirror image."""
    hz, out = more[-1].hz, []
    for k, s in enumerate(shapes):
        if abs(hz - s.hz) > reach(record, s):
            continue
        out.append(_refitted(record, modulated(record, shapes, k, abs(hz - s.hz))))
        if s.rates:
            out += [
                _refitted(record, more),
                _refitted(record, [*shapes, replace(more[-1], hz=2 * s.hz - hz)]),
            ]
    return out


def _refitted(record: Record, shapes: list[LineShape]) -> list[LineShape]:
    """Return the shapes refined, with their modulations estimated again."""
    shapes = refined(shapes, record.t, record.y, record.ends)
    changing = [k for k, s in enumerate(shapes) if s.rates]
    for k in changing:
        shapes = modulated(record, shapes, k)
    return refined(shapes, record.t, record.y, record.ends) if changing else shapes


def _cheapest(record: Record, options: list[list[LineShape]]) -> list[LineShape]:
    """Return the best option by Schwarz's criterion: misfit plus log T for each unknown."""
    if len(options) == 1:
        return options[0]
    left = [solved(o, record.t, record.y)[1] for o in options]
    best = int(np.argmin([(r**2).sum() for r in left]))
    levels = record.levels(options[best], left[best])
    at = record.bin_of(options[0][-1].hz, len(levels))
    width, price = record.y.shape[1], np.log(len(record.t))
    costs = [
        float(((r**2).sum(0) / levels[at]).sum())
        + price * (unknowns(o) + sum(2 * width + 1 + s.is_free + (s.start > 0) for s in o))
        for o, r in zip(options, left, strict=True)
    ]
    return options[int(np.argmin(costs))]


def _beginnings(record: Record, shapes: list[LineShape]) -> list[LineShape]:
    """Test again lines that begin in the record: another line, not yet found, may have looked like a beginning."""
    for k, s in enumerate(shapes):
        if s.start and len(shapes) > 1:
            others = [*shapes[:k], *shapes[k + 1 :]]
            begun = refined([*others, _begun(record, others, s)], record.t, record.y, record.ends)
            plain = refined([*others, replace(s, start=0, is_free=True)], record.t, record.y, record.ends)
            found = _simplest(record, [plain, begun])
            shapes = [*found[:k], found[-1], *found[k:-1]]
    return shapes


def _begun(record: Record, shapes: list[LineShape], shape: LineShape) -> LineShape:
    """Return the shape with the first sample that explains most, near that of its block."""
    reach = max(len(record.t) // 24, 2)
    earliest = int(np.searchsorted(record.t, record.t[0] + LEAST_PERIODS / shape.hz))
    starts = range(max(shape.start - reach, earliest), min(shape.start + reach, len(record.t) - 8))
    sizes = [(solved([*shapes, replace(shape, start=k)], record.t, record.y)[1] ** 2).sum() for k in starts]
    return replace(shape, start=starts[int(np.argmin(sizes))]) if sizes else shape


def _simplest(
    record: Record, options: list[list[LineShape]], levels: np.ndarray | None = None
) -> list[LineShape]:
    """Return the simplest option, steady, decaying or beginning, that no later one improves significantly.

    levels [F, D] of the noise; those that the best option leaves if not given.
    """
    left = [solved(o, record.t, record.y)[1] for o in options]
    best = int(np.argmin([(r**2).sum() for r in left]))
    levels = record.levels(options[best], left[best]) if levels is None else levels
    at = record.bin_of(options[best][-1].hz, len(levels))

    def misfit(k: int) -> float:
        return float(((left[k] ** 2).sum(0) / levels[at]).sum())

    chosen = 0
    for k, option in enumerate(options):
        tried, free = (len(record.t) / 4, 2) if option[-1].start else (1, 1)
        if misfit(chosen) - misfit(k) > chi2.isf(_SURE / tried, free):
            chosen = k
    return options[chosen]


def _settled(record: Record, shapes: list[LineShape]) -> list[LineShape]:
    """Return the shapes with all decays tested: fitted where they exceed their deviation, else held at 0.

    What a codec may have made of a steady line must be exceeded, too.
    """
    if not shapes:
        return shapes
    duration = float(np.ptp(record.t))
    free = _refitted(record, [replace(s, is_free=True) for s in shapes])
    phasors, residual = solved(free, record.t, record.y)
    errors = covariances(record, free, phasors, record.levels(free, residual))
    sure = np.sqrt(chi2.isf(_SURE, 1))
    out = []
    for s, p, c in zip(free, phasors, errors, strict=True):
        lasting = duration - float(record.t[s.start] - record.t[0])
        least, coded = LEAST_CHANGE / lasting, record.coded_change(s, p) / lasting
        changes = abs(s.decay) > max(sure * np.sqrt(c[1, 1]) + coded, least)
        out.append(s if changes else replace(s, decay=0.0, is_free=False))
    return _refitted(record, out)


def _kept(record: Record, shapes: list[LineShape]) -> list[LineShape]:
    """Return the significant lines, with their decays tested."""
    shapes = _settled(record, shapes)
    while shapes and (kept := _without_most_doubtful(record, shapes)) != shapes:
        shapes = _settled(record, kept)
    return shapes


def _without_most_doubtful(record: Record, shapes: list[LineShape]) -> list[LineShape]:
    """Return all but the weakest line that may be noise, a leftover of a stronger line, or part of its neighbour."""
    phasors, residual = solved(shapes, record.t, record.y)
    levels = record.levels(shapes, residual)
    errors = covariances(record, shapes, phasors, levels)
    strength = np.array([wald(p, c) for p, c in zip(phasors, errors, strict=True)])
    size = np.array([np.linalg.norm(p) for p in phasors])
    least = chi2.isf(record.chance / (_TRIED * len(record.t)), 2 * record.y.shape[1])
    at_end = np.array([min(abs(s.hz - e) for e in record.ends) < 1e-6 * record.ends[1] for s in shapes])
    doubtful = at_end | (strength < least) | (size < _LEAST_SIZE * size.max())
    resolution = 1 / (float(np.ptp(record.t)) * len(record.t) / (len(record.t) - 1))
    for i, a in enumerate(shapes):
        for j, b in enumerate(shapes):
            if i != j and abs(a.hz - b.hz) < resolution and strength[i] <= strength[j]:
                doubtful[i] |= not _are_two(record, shapes, i, j, levels)
    doubtful |= np.array([_is_change(record, shapes, k, size) for k in range(len(shapes))])
    if not doubtful.any():
        return shapes
    out = int(np.where(doubtful, strength, np.inf).argmin())
    return [s for k, s in enumerate(shapes) if k != out]


def _is_change(record: Record, shapes: list[LineShape], i: int, size: np.ndarray) -> bool:
    """Return whether a change of a stronger line near line i explains it."""
    for j, s in enumerate(shapes):
        if size[j] > size[i] and abs(shapes[i].hz - s.hz) < reach(record, s):
            alone = [other for k, other in enumerate(shapes) if k != i]
            alone = _refitted(record, modulated(record, alone, j - (j > i), abs(shapes[i].hz - s.hz)))
            if _cheapest(record, [shapes, alone]) is alone:
                return True
    return False


def _are_two(record: Record, shapes: list[LineShape], i: int, j: int, levels: np.ndarray) -> bool:
    """Return whether one decaying line in place of both leaves a significantly larger residual."""
    rest = [s for k, s in enumerate(shapes) if k not in (i, j)]
    one = refined([*rest, replace(shapes[j], is_free=True)], record.t, record.y, record.ends)
    left = [(solved(o, record.t, record.y)[1] ** 2).sum(0) for o in (one, shapes)]
    at = record.bin_of(shapes[j].hz, len(levels))
    gain = float(((left[0] - left[1]) / levels[at]).sum())
    return gain > chi2.isf(_SURE / len(record.t), 2 * record.y.shape[1] + 1)
