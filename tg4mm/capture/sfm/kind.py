"""The kind of capture in a folder, the reason for the decision, and the options that do not apply to it.

A video whose camera walks round the scene and then stands, or the other way round, is divided into both parts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from tg4mm.capture.sfm.clip import FEWEST, SWEEP, Clip, Sources, TimeWindow, clip_frames
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.defects import is_fixed
from tg4mm.capture.sfm.steadiness import FIXED_PX, FIXED_SHARE, ShiftMeter, reduced, runs
from tg4mm.capture.sfm.survey import Survey
from tg4mm.capture.video import is_turned
from tg4mm.core.choices import KINDS, Kind
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.files import argument
from tg4mm.core.progress import progress

STEP_S = 0.125
STANDS_S = 1.0  # at least
_OF_FIXED = 0.25  # of the shift that a fixed camera may have in all, from picture to picture
_WALK = 0.5  # of the picture's longer side that pictures go by in a walk, together
_FEWEST = 6  # pictures of a walk


def possible_kinds(sources: Sources) -> tuple[Kind, ...]:
    """Return the possible kinds of the files on disk, the most likely first."""
    if sources.photographs is not None:
        layout = "photographs"
    elif len(sources.clips) > 1:
        layout = "recordings"
    else:
        layout = "recording" if sources.sweep is None else "recording and sweep"
    return tuple(sorted((k for k in Kind if layout in k.found_in), key=lambda k: k.still))


def check_kind(sources: Sources, requested: str | None) -> None:
    """Raise Tg4mmError where the kind asked for is none, or not one that these sources can be."""
    if requested is None:
        return
    if requested not in KINDS:
        raise Tg4mmError(f"--kind is {requested}, expected {', '.join(KINDS)}")
    possible = possible_kinds(sources)
    if requested not in possible:
        raise CaptureError(
            f"--kind is {requested}, but {sources.path} holds {described(sources)}, "
            f"which can be {' or '.join(possible)}"
        )


def described(sources: Sources) -> str:
    """Describe the files on disk."""
    if sources.photographs is not None:
        return f"{len(sources.photographs.pictures)} photographs"
    n = len(sources.clips)
    cameras = "one recording" if n == 1 else f"{n} recordings"
    return f"{cameras}, and a sweep" if sources.sweep is not None else cameras


def kind_of(sources: Sources, surveys: Sequence[Survey], requested: str | None) -> tuple[Kind, str]:
    """The kind of these sources and the reason for it, a clause; surveys are those of `sources.clips`."""
    if requested is not None:
        return Kind(requested), "as --kind says"
    possible = possible_kinds(sources)
    if len(surveys) > 1:
        in_turn = _one_after_another(surveys)
        kind = next(k for k in possible if k.in_turn == in_turn)
    elif surveys:
        fixed = is_fixed(surveys[0])
        kind = next(k for k in possible if k.fixed == fixed)
    else:
        kind = possible[0]
    return kind, f"holds {described(sources)}{kind.because}"


def _one_after_another(surveys: Sequence[Survey]) -> bool:
    """Return whether no two recordings overlap in time, according to their containers."""
    spans = []
    for survey in surveys:
        if survey.created_s is None or survey.times is None:
            return False
        spans.append((survey.created_s, survey.created_s + float(survey.times[-1])))
    spans.sort()
    return all(before[1] <= after[0] for before, after in pairwise(spans))


def check_fits(images: Path, kind: Kind, surveys: Sequence[Survey], config: SfmConfig) -> None:
    """Raise Tg4mmError for options that a capture of this kind has no use for."""
    if config.test_every and not kind.holds_out:
        raise Tg4mmError(f"--test-every is {config.test_every}, but {kind} has no camera to hold out")
    if config.synchronous and not kind.together:
        raise Tg4mmError(f"--synchronous is for the cameras of a rig, but {images} is recognised as {kind}")
    if config.synchronous:
        _check_as_long(surveys)
    if config.readout_s:
        _check_readout(images, kind, surveys, config)


def _check_readout(images: Path, kind: Kind, surveys: Sequence[Survey], config: SfmConfig) -> None:
    if not kind.fixed:
        raise Tg4mmError(f"--readout is for fixed cameras, but {images} is recognised as {kind}")
    assert config.readout_s is not None
    for survey in surveys:
        frame_s = 1 / float(survey.clock(config.fps)[0])
        if config.readout_s > frame_s:
            raise Tg4mmError(
                f"--readout is {1e3 * config.readout_s:g}, expected at most the {1e3 * frame_s:.4g} ms of a frame of "
                f"{survey.path.name}"
            )
        if survey.path.is_file() and is_turned(survey.path):
            raise Tg4mmError(
                f"--readout is for pictures that are stored upright, but {survey.path.name} is rotated when it is "
                "shown; leave it out"
            )


def _check_as_long(surveys: Sequence[Survey]) -> None:
    """Raise CaptureError where cameras that were started together hold different numbers of pictures."""
    longest, shortest = max(surveys, key=len), min(surveys, key=len)
    if len(longest) > len(shortest):
        until = (
            float(shortest.times[-1]) + 0.5 / float(shortest.fps) if shortest.times and shortest.fps else None
        )
        what = "leave out pictures" if until is None else f"--until {until:.3f} takes as many of each"
        raise CaptureError(
            f"{longest.path}: holds {len(longest)} frames, {shortest.path.name} {len(shortest)}, but --synchronous was "
            f"given: {what}"
        )


def check_options(sources: Sources, config: SfmConfig) -> None:
    """Refuse options that do not apply to the files on disk."""
    if config.synchronous and not any(kind.together for kind in possible_kinds(sources)):
        raise Tg4mmError(
            f"--synchronous is for the cameras of a rig, but {sources.path} holds {described(sources)}"
        )
    frames = [clip.name for clip in sources.clips if clip.is_untimed]
    if frames and config.fps is None and not (config.kind and Kind(config.kind).still):
        raise Tg4mmError(
            f"--fps is missing: the pictures in {', '.join(frames[:4])} need their frames per second"
        )
    moving = sources.sweep is not None and sources.sweep.is_video
    if config.frames is not None and not moving and len(sources.clips) != 1:
        raise Tg4mmError(
            f"--frames is {config.frames}, but there is no video of a moving camera to take them from"
        )


def check_enough(sources: Sources) -> None:
    """Raise CaptureError for so few fixed cameras that their poses cannot be found, and nothing beside them."""
    n = len(sources.clips)
    if sources.sweep is None and 1 < n < FEWEST:
        first = argument(sources.clips[0].path)
        raise CaptureError(
            f"{sources.path}: holds {n} recordings of fixed cameras, and nothing else: {n} views are too few "
            f"to find poses from. Add {SWEEP}/ with photographs of the scene at rest from all around (or {SWEEP}.mp4), "
            f"or take one camera by itself, in pixels: tg4mm sfm {first} --out DATASET"
        )


@dataclass(frozen=True)
class Divided:
    """One video as two: the part of the fixed camera, and the sweep."""

    sources: Sources
    config: SfmConfig  # whose window is the part that stands
    parts: "StaticSegment"

    def __str__(self) -> str:
        return str(self.parts)


def divided(sources: Sources, surveys: Sequence[Survey], config: SfmConfig) -> Divided | None:
    """The one video of a camera that walks and stands; None where it does not, or something says how to take it."""
    is_free = config.kind is None and config.window.is_all and sources.sweep is None
    if not is_free or len(sources.clips) != 1 or not sources.clips[0].is_video or is_fixed(surveys[0]):
        return None
    found = static_segment(sources.clips[0], surveys[0], config.window)
    if found is None:
        return None
    sweep = Clip(SWEEP, sources.clips[0].path, window=found.walks)
    stands = replace(config, start_s=found.stands.start_s, stop_s=found.stands.stop_s)
    # rows of repeats count from the window's first frame
    whole = replace(sources.clips[0], repeats=frozenset())
    return Divided(replace(sources, clips=(whole,), sweep=sweep), stands, found)


@dataclass(frozen=True)
class StaticSegment:
    """Seconds since the video's first frame."""

    stands: TimeWindow
    walks: TimeWindow

    def __str__(self) -> str:
        walk, stand = (f"{w.start_s:.2f} to {w.stop_s:.2f} s" for w in (self.walks, self.stands))
        return f"the camera walks from {walk} and stands from {stand}"


def static_segment(clip: Clip, survey: Survey, window: TimeWindow) -> StaticSegment | None:
    """The longest part of a video in which its camera stands, and the longer walk before or after it.

    None where there are not both: a camera that stands for a second or more, and one that goes round.
    """
    if survey.times is None:
        return None
    times, steps = _steps(clip, survey, window)
    most = _OF_FIXED * max(FIXED_PX, FIXED_SHARE * max(survey.size))
    still = [(a, b) for a, b in runs(steps <= most) if times[b] - times[a] >= STANDS_S]
    if not still:
        return None
    first, stop = max(still, key=lambda run: times[run[1]] - times[run[0]])
    walks = [(a, b) for a, b in ((0, first), (stop, len(steps))) if b - a >= _FEWEST]
    longer = max(survey.size)  # the scale for a picture of something else
    walks = [w for w in walks if np.minimum(steps[slice(*w)], longer).sum() >= _WALK * longer]
    if not walks:
        return None
    walk = max(walks, key=lambda run: run[1] - run[0])
    begin, end = float(times[first]), float(times[stop])
    # a video that goes on to its end stands to its end; the last moment before a walk is one of taking it up
    end = float(survey.times[-1]) + STEP_S if stop == len(steps) else end
    last = float(survey.times[-1]) + STEP_S if walk[1] == len(steps) else float(times[walk[1]])
    return StaticSegment(TimeWindow(begin, end), TimeWindow(float(times[walk[0]]), last))


def _steps(clip: Clip, survey: Survey, window: TimeWindow) -> tuple[np.ndarray, np.ndarray]:
    """Times [n + 1] in seconds of pictures STEP_S apart, and how far each goes from the one before [n]; inf: unlike."""
    assert survey.times is not None
    seconds = np.array([float(t) for t in survey.times])
    every = max(round(STEP_S / float(np.median(np.diff(seconds)))), 1)
    times, steps, before = [], list[float](), None
    with progress(f"steps of {clip.name}", len(survey), "frames") as update:
        for frame in clip_frames(clip, window):
            if frame.index % every:
                continue
            grey, k = reduced(frame.pixels[..., 1])
            if before is not None:
                shift = k * float(np.hypot(*before.shift(grey)))
                steps.append(shift if np.isfinite(shift) else np.inf)
            before = ShiftMeter(grey)
            times.append(seconds[frame.index])
            update(frame.index + 1)
    return np.array(times), np.array(steps)
