"""Which kind of capture a folder holds, and why it is taken for one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from tg4mm.capture.sfm.sources import Sources
from tg4mm.capture.sfm.spoilt import is_fixed
from tg4mm.capture.sfm.survey import Survey
from tg4mm.core.choices import KINDS, Kind
from tg4mm.core.errors import CaptureError, Tg4mmError


def possible_kinds(sources: Sources) -> tuple[Kind, ...]:
    """The kinds that what lies on disk can be, the most likely first."""
    if sources.photographs is not None:
        layout = "photographs"
    elif len(sources.clips) > 1:
        layout = "recordings"
    else:
        layout = "recording" if sources.sweep is None else "recording and sweep"
    return tuple(sorted((k for k in Kind if layout in k.found_in), key=lambda k: k.still))


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


def kind_of(sources: Sources, surveys: Sequence[Survey], asked: str | None) -> tuple[Kind, str]:
    """The kind of these sources and the reason for it, a clause; surveys are those of `sources.clips`."""
    if asked is not None:
        return Kind(asked), "as --kind says"
    possible = possible_kinds(sources)
    if len(surveys) > 1:
        in_turn = _one_after_another(surveys)
        kind = next(k for k in possible if k.in_turn == in_turn)
    elif surveys:
        fixed = is_fixed(surveys[0])
        kind = next(k for k in possible if k.fixed == fixed)
    else:
        kind = possible[0]
    return kind, f"holds {held(sources)}{kind.because}"


def _one_after_another(surveys: Sequence[Survey]) -> bool:
    """Whether the containers say that no two recordings overlap in time."""
    spans = []
    for survey in surveys:
        if survey.created_s is None or survey.times is None:
            return False
        spans.append((survey.created_s, survey.created_s + float(survey.times[-1])))
    spans.sort()
    return all(before[1] <= after[0] for before, after in pairwise(spans))
