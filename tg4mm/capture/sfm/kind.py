"""Which kind of capture a folder holds, and why it is taken for one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tg4mm.capture.sfm.sources import Sources
from tg4mm.capture.sfm.spoilt import is_fixed
from tg4mm.capture.sfm.survey import Survey
from tg4mm.core.choices import KINDS
from tg4mm.core.errors import CaptureError, Tg4mmError


@dataclass(frozen=True)
class Kind:
    """A capture kind and the reason for it, one clause."""

    name: str  # one of KINDS
    reason: str


def possible_kinds(sources: Sources) -> tuple[str, ...]:
    """The kinds that what lies on disk can be, the most likely first."""
    if sources.photographs is not None:
        return ("photos",)
    if len(sources.clips) > 1:
        return ("rig", "clips")
    return ("tripod", "handheld") if sources.sweep is not None else ("flat", "handheld", "photos")


def check_kind(sources: Sources, asked: str | None) -> None:
    """Raise Tg4mmError where the kind asked for is none, or not one that these sources can be."""
    if asked is None:
        return
    if asked not in KINDS:
        raise Tg4mmError(f"--kind is {asked}, expected {', '.join(KINDS)}")
    possible = possible_kinds(sources)
    if asked not in possible:
        raise CaptureError(
            f"--kind is {asked}, but {sources.path} holds {held(sources)}, "
            f"which can be {' or '.join(possible)}"
        )


def held(sources: Sources) -> str:
    """What lies on disk, in words."""
    if sources.photographs is not None:
        return f"{len(sources.photographs.pictures)} photographs"
    n = len(sources.clips)
    cameras = "one recording" if n == 1 else f"{n} recordings"
    return f"{cameras}, and a sweep" if sources.sweep is not None else cameras


def told_kind(sources: Sources, surveys: Sequence[Survey], asked: str | None) -> Kind:
    """The kind of these sources; surveys are those of `sources.clips`."""
    if asked is not None:
        return Kind(asked, "as --kind says")
    holds = held(sources)
    if sources.photographs is not None:
        return Kind("photos", f"holds {holds}")
    if len(surveys) > 1:
        if _one_after_another(surveys):
            return Kind("clips", f"holds {holds}, begun one after another's end; otherwise pass --kind rig")
        return Kind("rig", f"holds {holds}; one camera that filmed from several places is --kind clips")
    fixed = is_fixed(surveys[0])
    reason = f"holds {holds}; the camera {'stays put' if fixed else 'moves'}"
    if not fixed:
        return Kind("handheld", reason)
    return Kind("flat" if sources.sweep is None else "tripod", reason)


def _one_after_another(surveys: Sequence[Survey]) -> bool:
    """Whether the containers say that no two recordings overlap in time."""
    spans = []
    for survey in surveys:
        if survey.created_s is None or survey.times is None:
            return False
        spans.append((survey.created_s, survey.created_s + float(survey.times[-1])))
    spans.sort()
    return all(before[1] <= after[0] for before, after in pairwise(spans))
