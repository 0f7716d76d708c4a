"""A video that walks round the scene and then stands, or stands and then walks: which part is which."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tg4mm.capture.sfm.clip import Clip, Window, clip_frames
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.defects import is_fixed
from tg4mm.capture.sfm.frozen import runs
from tg4mm.capture.sfm.sources import SWEEP, Sources
from tg4mm.capture.sfm.steadiness import FIXED_PX, FIXED_SHARE, ShiftMeter, reduced
from tg4mm.capture.sfm.survey import Survey
from tg4mm.core.progress import progress

STEP_S = 0.125
STANDS_S = 1.0  # at least
_OF_FIXED = 0.25  # of the shift that a fixed camera may have in all, from picture to picture
_WALK = 0.5  # of the picture's longer side that pictures go by in a walk, together
_FEWEST = 6  # pictures of a walk


@dataclass(frozen=True)
class Divided:
    """One video as two: what is taken for the fixed camera, and for the sweep."""

    sources: Sources
    config: SfmConfig  # whose window is the part that stands
    parts: "Standing"

    def __str__(self) -> str:
        return str(self.parts)


def divided(sources: Sources, surveys: Sequence[Survey], config: SfmConfig) -> Divided | None:
    """The one video of a camera that walks and stands; None where it does not, or something says how to take it."""
    is_free = config.kind is None and config.window.is_all and sources.sweep is None
    if not is_free or len(sources.clips) != 1 or not sources.clips[0].is_video or is_fixed(surveys[0]):
        return None
    found = standing(sources.clips[0], surveys[0], config.window)
    if found is None:
        return None
    sweep = Clip(SWEEP, sources.clips[0].path, window=found.walks)
    stands = replace(config, start_s=found.stands.start_s, stop_s=found.stands.stop_s)
    whole = replace(
        sources.clips[0], repeats=frozenset()
    )  # rows of repeats count from the window's first frame
    return Divided(replace(sources, clips=(whole,), sweep=sweep), stands, found)


@dataclass(frozen=True)
class Standing:
    """Seconds since the video's first frame."""

    stands: Window
    walks: Window

    def __str__(self) -> str:
        walk, stand = (f"{w.start_s:.2f} to {w.stop_s:.2f} s" for w in (self.walks, self.stands))
        return f"the camera walks from {walk} and stands from {stand}"


def standing(clip: Clip, survey: Survey, window: Window) -> Standing | None:
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
    walks = [w for w in walks if _gone(steps[slice(*w)], max(survey.size)) >= _WALK * max(survey.size)]
    if not walks:
        return None
    walk = max(walks, key=lambda run: run[1] - run[0])
    begin, end = float(times[first]), float(times[stop])
    # a video that goes on to its end stands to its end; the last moment before a walk is one of taking it up
    end = float(survey.times[-1]) + STEP_S if stop == len(steps) else end
    last = float(survey.times[-1]) + STEP_S if walk[1] == len(steps) else float(times[walk[1]])
    return Standing(Window(begin, end), Window(float(times[walk[0]]), last))


def _steps(clip: Clip, survey: Survey, window: Window) -> tuple[np.ndarray, np.ndarray]:
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


def _gone(steps: np.ndarray, longest: int) -> float:
    """Pixels that pictures go by, together; an unlike one by all that it shows."""
    return float(np.minimum(steps, longest).sum())
