"""Lines that a program names against a film's truth."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from benchmarks.calibration.draw import FilmTruth, TrueVibration

_NEAR_PX = 12  # around a region in which a line belongs to it
EDGES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5)  # amplitudes, pixels


@dataclass(frozen=True)
class Named:
    """A line that a program names."""

    hz: float
    hz_deviation: float
    amplitude_px: float | None = None
    amplitude_deviation_px: float | None = None
    damping: float | None = None
    damping_deviation: float | None = None
    start_s: float = 0.0  # where the amplitude is of what decays
    centre_px: tuple[float, float] | None = None
    marked: bool = False
    lower_bound: bool = False  # the amplitude is marked as too small, by more than its ±


@dataclass
class Score:
    """One film's: errors over their ±, what was found of what there is."""

    frequencies: list[float] = field(default_factory=list)
    amplitudes: list[float] = field(default_factory=list)
    dampings: list[float] = field(default_factory=list)
    samples: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)  # px, rms of regions' series, right, down
    false: list[str] = field(default_factory=list)
    marked: int = 0  # false lines that were marked
    ratios: list[float] = field(default_factory=list)  # amplitudes, found over true
    bounds: list[float] = field(default_factory=list)  # like amplitudes, of those marked as too small
    found: list[tuple[float, bool]] = field(default_factory=list)  # true amplitude, px; was it named?
    strongest_px: float | None = None
    strongest_named: bool = False
    is_still: bool = False
    seconds: float = 0.0  # of processor time


def score(truth: FilmTruth, named: Sequence[Named], seconds: float) -> Score:
    """Every true vibration takes the line without a mark nearest to it, within 1 / duration or 3 of its ±."""
    out, left = Score(seconds=seconds, is_still=not truth.vibrations), [n for n in named if not n.marked]
    by_size = sorted(truth.vibrations, key=lambda v: -v.size_px)
    for k, vibration in enumerate(by_size):
        best = _nearest(vibration, left, truth.duration_s)
        out.found.append((vibration.size_px, best is not None))
        if k == 0:
            out.strongest_px, out.strongest_named = vibration.size_px, best is not None
        if best is not None:
            left.remove(best)
            _compare(out, vibration, best)
    out.false = [f"{n.hz:.3f} Hz {n.amplitude_px or 0:.3f} px" for n in left]
    out.marked = sum(n.marked for n in named)
    return out


def _nearest(vibration: TrueVibration, named: Iterable[Named], duration_s: float) -> Named | None:
    near = [n for n in named if abs(n.hz - vibration.hz) < max(1 / duration_s, 3 * n.hz_deviation)]
    return min(near, key=lambda n: abs(n.hz - vibration.hz), default=None)


def _compare(out: Score, true: TrueVibration, named: Named) -> None:
    out.frequencies.append((named.hz - true.hz) / named.hz_deviation)
    left, upper, right, lower = true.region
    x, y = named.centre_px or ((left + right) / 2, (upper + lower) / 2)
    inside = left - _NEAR_PX < x < right + _NEAR_PX and upper - _NEAR_PX < y < lower + _NEAR_PX
    if inside and named.amplitude_px is not None and named.amplitude_deviation_px:
        size, deviation = named.amplitude_px, named.amplitude_deviation_px
        if true.damping is not None and named.damping is not None:
            rate = 2 * np.pi * named.hz
            grown = float(np.exp(-named.damping * rate * (true.start_s - named.start_s)))
            of_rate = size * rate * abs(true.start_s - named.start_s) * (named.damping_deviation or 0)
            size, deviation = size * grown, float(np.hypot(deviation, of_rate)) * grown
        if (true.damping is None) == (named.damping is None):
            errors, at = out.bounds if named.lower_bound else out.amplitudes, true.size_px * true.at(y)
            errors.append((size - at) / deviation)
            out.ratios.append(size / max(at, 1e-9))
    if true.damping is not None and named.damping is not None and named.damping_deviation:
        out.dampings.append((named.damping - true.damping) / named.damping_deviation)


def table(scores: Sequence[Score]) -> str:
    """Coverage, false lines and recall of many films."""
    lines = ["| | within 1 ± | within 2 ± | worst | of |", "|---|---:|---:|---:|---:|"]
    kinds: list[tuple[str, Callable[[Score], list[float]]]] = [
        ("samples", lambda s: s.samples),
        ("frequencies", lambda s: s.frequencies),
        ("amplitudes", lambda s: s.amplitudes),
        ("amplitudes marked as too small", lambda s: s.bounds),
        ("damping ratios", lambda s: s.dampings),
    ]
    for name, of in kinds:
        z = np.abs(np.array([value for s in scores for value in of(s)]))
        if len(z):
            cells = f"{np.mean(z < 1):.0%} | {np.mean(z < 2):.0%} | {z.max():.1f} | {len(z)}"
            lines.append(f"| {name} | {cells} |")
    still = [s for s in scores if s.is_still]
    judged = [s for s in scores if s.strongest_px is not None]  # films; of sets no line is the strongest
    sure = [s for s in judged if (s.strongest_px or 0) >= 0.1]
    false = sum(len(s.false) for s in scores)
    lines += [
        "",
        f"films on which nothing vibrates with a line: {sum(bool(s.false) for s in still)} of {len(still)}",
        f"false lines without a mark: {false} on {len(scores)} films; with one: {sum(s.marked for s in scores)}",
        f"strongest vibration named: {share(s.strongest_named for s in judged)}; "
        f"of .1 px or more: {share(s.strongest_named for s in sure)}",
        f"median processor time: {np.median([s.seconds for s in scores]):.1f} s",
        "",
        "| true amplitude, px | named |",
        "|---|---:|",
    ]
    found = [pair for s in scores for pair in s.found]
    for low, high in pairwise(EDGES):
        lines.append(f"| {low:g} to {high:g} | {share(f for a, f in found if low <= a < high)} |")
    lines += ["", smallest_found(found)]
    return "\n".join(lines)


def compared(ours: Sequence[Score], theirs: Sequence[Score]) -> str:
    """A line: errors of series, film by film, over those of another method on the same regions."""
    pairs = zip(ours, theirs, strict=True)
    ratios = np.array([a / b for s, t in pairs for a, b in zip(s.errors, t.errors, strict=True)])
    if not len(ratios):
        return "no series to compare"
    return (
        f"geometric mean {np.exp(np.log(ratios).mean()):.2f}, median {np.median(ratios):.2f}, "
        f"largest {ratios.max():.1f} of {len(ratios)} axes"
    )


def share(flags: Iterable[bool]) -> str:
    """Return the number of true flags and of all flags as text."""
    flags = list(flags)
    return f"{sum(flags)} of {len(flags)}"


def smallest_found(found: Sequence[tuple[float, bool]], wanted: float = 0.9) -> str:
    """The amplitude from which `wanted` of the vibrations are named, by logistic regression on its logarithm."""
    from scipy.optimize import minimize

    if len({f for _, f in found}) < 2:
        return "recall by amplitude: too few vibrations to tell"
    x, y = np.log([a for a, _ in found]), np.array([f for _, f in found], float)

    def loss(p: np.ndarray) -> float:
        z = p[0] + p[1] * (x + 3)
        return float(np.logaddexp(0, np.where(y > 0, -z, z)).sum() + 0.01 * p[1] ** 2)

    a, b = minimize(loss, np.zeros(2), method="BFGS").x
    if b <= 0:
        return "recall does not rise with amplitude"
    at = float(np.exp((np.log(wanted / (1 - wanted)) - a) / b - 3))
    return f"{wanted:.0%} are named from {at:.3f} px on (logistic fit)"
