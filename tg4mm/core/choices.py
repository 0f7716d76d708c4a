"""Values of options and files that many parts know by name, each list written once. Needs Python's library alone."""

from __future__ import annotations

from enum import StrEnum


class Kind(StrEnum):
    """Kinds of capture."""

    photos = "photos"  # a still scene
    flat = "flat"  # one fixed camera and nothing else
    tripod = "tripod"  # one fixed camera, and pictures of the scene at rest
    handheld = "handheld"  # one camera that moves all the time
    rig = "rig"  # several fixed cameras
    clips = "clips"  # one camera that filmed from several places, one after another


class Filter(StrEnum):
    """Temporal filters (tg4mm/core/filters.py)."""

    zero_phase = "zero-phase"
    ideal = "ideal"
    published = "published"


class Method(StrEnum):
    """Methods of magnification (tg4mm/core/magnification.py)."""

    modal = "modal"
    linear = "linear"
    phase = "phase"


KINDS = tuple(kind.value for kind in Kind)
FILTERS = tuple(kind.value for kind in Filter)
METHODS = tuple(method.value for method in Method)
