"""Unusable parts of a recording: black, frozen, of another scene, or beyond a knock of the camera; changes of light."""

import math
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

from tg4mm.capture.duplicates import OFF
from tg4mm.capture.model import FEWEST_FRAMES, FEWEST_MOVING
from tg4mm.capture.sfm.clip import uneven_steps
from tg4mm.capture.sfm.steadiness import (
    KNOCK_FRAMES,
    MOST_KNOCKS,
    Knock,
    find_bumps,
    find_knocks,
    runs,
    stays_in_parts,
)
from tg4mm.capture.sfm.survey import NOTHING, Survey
from tg4mm.core.errors import CaptureError

NAMED = 3  # faults and stretches that a message lists
OTHER_RATE = 0.01  # part of the container's frame rate that --fps must differ by to be another one

_SECONDS = 0.3  # that a value is the median of
_REPORTED = 0.02  # relative change from which it is reported


@dataclass(frozen=True)
class Stretches:
    """The segments of a recording, as frame ranges: first, end (exclusive)."""

    faults: list[tuple[int, int, str]]  # with what is wrong; a knock has first = end
    good: list[tuple[int, int]]


def is_fixed(survey: Survey) -> bool:
    """Return whether the camera was fixed apart from knocks, cuts and dark moments."""
    knocks = _knocks(survey)
    if len(knocks) > MOST_KNOCKS:
        return False
    marks = [knock.frame for knock in knocks]
    stretches = [piece for part in _parts(survey) for piece in _split(part, marks)]
    return stays_in_parts(survey.shifts_px, stretches, max(survey.size))


def stretches_of(survey: Survey, fixed: bool) -> Stretches:
    """Return the faults of a recording and the parts between them; without `fixed` any change of view is allowed."""
    black = survey.parts == NOTHING
    kinds = [(black, "is black"), (survey.frozen & ~black, "shows one frozen picture")]
    if fixed:
        seen = survey.parts[~black]
        main = int(np.bincount(seen).argmax()) if len(seen) else 0
        kinds.append((~black & (survey.parts != main), "shows another picture"))
    faults, spoilt = [], np.zeros(len(survey), bool)
    for flags, what in kinds:
        for first, stop in runs(flags):
            if stop - first >= KNOCK_FRAMES:
                faults.append((first, stop, what))
                spoilt[first:stop] = True
    knocks = _knocks(survey) if fixed else []
    faults += [(k.frame, k.frame, f"the whole picture moves by {k.shift_px:.1f} pixels") for k in knocks]
    marks = [knock.frame for knock in knocks]
    good = [piece for run in runs(~spoilt) for piece in _split(run, marks)]
    return Stretches(sorted(faults), good)


def check_usable(surveys: Iterable[Survey], fixed: bool) -> None:
    """Raise CaptureError, naming the usable part, for a recording that is partly spoilt or too short.

    fixed: whether its camera has to stay put.
    """
    for survey in surveys:
        found = stretches_of(survey, fixed)
        if fixed and not is_fixed(survey):
            raise CaptureError(f"{survey.path}: {_moves(survey)}; for a moving camera use --kind handheld")
        if found.faults:
            raise CaptureError(f"{survey.path}: {_fault_text(survey, found)}")
        fewest = FEWEST_FRAMES if fixed else FEWEST_MOVING
        if len(survey) < fewest:
            raise CaptureError(
                f"{survey.path}: holds {len(survey)} frames, too few to show motion; at least {fewest} are needed"
            )


def warn_bumps(surveys: Iterable[Survey]) -> None:
    """A warning for each recording of a fixed camera that was pushed and came back, or was covered, for some frames."""
    for survey in surveys:
        bumps = find_bumps(survey.shifts_px, _times(survey))
        if bumps:
            listed = ", ".join(
                f"{_moment(survey, first)} (by {px:.1f} pixels)" for first, _, px in bumps[:NAMED]
            )
            more = f" and {len(bumps) - NAMED} more times" if len(bumps) > NAMED else ""
            warnings.warn(
                f"{survey.path.name}: the camera was bumped and came back at {listed}{more}; "
                "motion at these times is the camera's",
                stacklevel=2,
            )


def warn_clocks(surveys: Iterable[Survey], fps: float | None) -> None:
    """A warning for each recording whose frame rate varies, or is given as another than the container's.

    And for one that shows pictures more than once.
    """
    for survey in surveys:
        if survey.repeats:
            warnings.warn(f"{survey.path.name}: {_duplicates(survey)}", stacklevel=2)
        if survey.times is None or survey.fps is None:
            continue
        steps = uneven_steps(_times(survey))
        if steps is not None:
            warnings.warn(
                f"{survey.path.name}: the frame rate varies, with steps of {steps[0] * 1e3:.1f} to "
                f"{steps[1] * 1e3:.1f} ms; each frame keeps its own time",
                stacklevel=2,
            )
        written = float(survey.fps)
        if fps is not None and abs(fps / written - 1) > OTHER_RATE:
            how = f"divided by {fps / written:.4g}" if fps > written else f"multiplied by {written / fps:.4g}"
            warnings.warn(
                f"{survey.path.name}: the file says {written:.5g} frames per second, --fps {fps:g}: "
                f"its times are {how}, as of slow motion",
                stacklevel=2,
            )


def _duplicates(survey: Survey) -> str:
    count, tail = len(survey.repeats), f"{OFF} keeps them all"
    if survey.share is None:
        return (
            f"{count} of {count + len(survey)} frames are duplicates of the one before them, in no pattern; they are "
            f"left out, and the others keep their times; {tail}"
        )
    new, of, rates = survey.share.numerator, survey.share.denominator, ""
    if survey.fps is not None:
        stored = float(survey.fps / survey.share)
        rates = f", {float(survey.fps):.5g} pictures a second stored as {stored:.5g}"
    return (
        f"{new} of {of} frames are new pictures{rates}; {count} duplicates are left out, and the others have the times "
        f"of that rate; {tail}"
    )


def motion_of(survey: Survey) -> str:
    """Return the reason, one clause, why a camera counts as moving."""
    return _moves(survey).removeprefix("was not filmed by a fixed camera: ")


def _moves(survey: Survey) -> str:
    seen = survey.shifts_px[np.isfinite(survey.shifts_px).all(axis=1)]
    alike = len(seen) / len(survey)
    if alike < 0.5:
        return f"was not filmed by a fixed camera: {1 - alike:.0%} of its pictures are unlike the first"
    away = np.linalg.norm(seen - np.median(seen, axis=0), axis=1).max()
    return f"was not filmed by a fixed camera: its picture moves by {away:.0f} pixels"


def _fault_text(survey: Survey, found: Stretches) -> str:
    listed = [_fault(survey, *fault) for fault in found.faults[:NAMED]]
    if len(found.faults) > NAMED:
        listed.append(f"{len(found.faults) - NAMED} more such places")
    long = [piece for piece in found.good if piece[1] - piece[0] >= FEWEST_FRAMES]
    best = sorted(sorted(long, key=lambda piece: piece[0] - piece[1])[:NAMED])
    advice = " or ".join(_options(survey, *piece) for piece in best)
    return f"{'; '.join(listed)}; {f'take {advice}' if advice else 'no part of it is long enough; record it again'}"


def _fault(survey: Survey, first: int, stop: int, what: str) -> str:
    if first == stop:
        return f"the camera was knocked {_at(survey, first)}: {what}"
    if survey.times is None:
        return f"{what} from picture {first} to {stop - 1}"
    return f"{what} from {_moment(survey, first)} to {_moment(survey, stop - 1)}"


def _at(survey: Survey, frame: int) -> str:
    return f"before picture {frame}" if survey.times is None else f"at {_moment(survey, frame)}"


def _options(survey: Survey, first: int, stop: int) -> str:
    """The options that leave these frames, or the pictures of a folder."""
    if survey.times is None:
        return f"pictures {first} to {stop - 1} alone"
    begins = [f"--from {_floor(survey, first)}"] if first or survey.times[0] else []
    ends = [f"--until {_floor(survey, stop)}"] if stop < len(survey) else []
    return " ".join(begins + ends)


def _floor(survey: Survey, frame: int) -> str:
    """Seconds, rounded down: rounded up, --until would take the frame too, and --from would not."""
    assert survey.times is not None
    return f"{math.floor(survey.times[frame] * 1000) / 1000:.3f}"


def _moment(survey: Survey, frame: int) -> str:
    return f"picture {frame}" if survey.times is None else f"{_floor(survey, frame)} s"


def _times(survey: Survey) -> np.ndarray:
    """Return [T] seconds; of a folder, as if filmed at 30 frames per second."""
    return np.arange(len(survey)) / 30 if survey.times is None else np.array([float(t) for t in survey.times])


def _parts(survey: Survey) -> list[tuple[int, int]]:
    """First frame and end of each run of frames of one part, black ones left out."""
    changes = np.flatnonzero(np.diff(survey.parts)) + 1
    edges = [0, *changes.tolist(), len(survey)]
    return [(a, b) for a, b in pairwise(edges) if survey.parts[a] != NOTHING]


def _split(stretch: tuple[int, int], marks: list[int]) -> list[tuple[int, int]]:
    first, stop = stretch
    edges = [first, *(mark for mark in marks if first < mark < stop), stop]
    return list(pairwise(edges))


def _knocks(survey: Survey) -> list[Knock]:
    times = _times(survey)
    found = []
    for first, stop in _parts(survey):
        part = slice(first, stop)
        knocks = find_knocks(survey.shifts_px[part], times[part], survey.together[part])
        found += [Knock(first + knock.frame, knock.time_s, knock.shift_px) for knock in knocks]
    return found


def warn_light(surveys: Iterable[Survey]) -> None:
    """A warning for each recording of a fixed camera whose light or white balance changes by over 2 %."""
    for survey in surveys:
        if survey.times is None or len(survey.light) < len(survey):
            continue
        times = np.array([float(time) for time in survey.times])
        found = [_change(times, survey.light[:, :1]), _change(times, survey.light[:, 1:])]
        found_defects = [
            f"{what} changes by {100 * size:.3g} %, fastest at {at:.1f} s"
            for what, (size, at) in zip(("exposure", "white balance"), found, strict=True)
            if size > _REPORTED
        ]
        if found_defects:
            warnings.warn(
                f"{survey.path.name}: {' and '.join(found_defects)}; changes common to all of the picture are "
                "removed; lock both in the camera",
                stacklevel=2,
            )


def _change(times_s: np.ndarray, logs: np.ndarray) -> tuple[float, float]:
    """The largest relative change of logarithms [T, k], and when it is fastest, seconds."""
    window = 2 * max(round(_SECONDS / 2 / float(np.median(np.diff(times_s)))), 1) + 1
    smooth = median_filter(logs, (window, 1), mode="nearest")
    if len(smooth) <= window:
        return 0.0, 0.0
    k = int(np.ptp(smooth, axis=0).argmax())
    at = int(np.abs(smooth[window:, k] - smooth[:-window, k]).argmax()) + window // 2
    return float(np.expm1(np.ptp(smooth[:, k]))), float(times_s[at])
