"""Values of options and files that many parts know by name, each list written once. Needs Python's library alone."""

from enum import StrEnum
from typing import Any


class _OfKind:
    """Properties of a capture kind, with the defaults of kinds that do not override them."""

    about: str = ""  # for `tg4mm sfm --help`
    found_in: tuple[str, ...] = ()  # what of LAYOUTS it can lie in
    because: str = ""  # ends the sentence that says why recordings are taken for it
    still: bool = False  # the scene is; pictures have no times
    fixed: bool = False  # cameras stay put
    moving: bool = False  # one camera moves all the time
    sees_depth: bool = True  # else motion is known across the one camera's sight alone, in pixels
    together: bool = False  # several cameras film at the same time
    in_turn: bool = False  # each fixed camera has a clock, or a start of the vibration, of its own
    holds_out: bool = False  # a camera can be kept for tests
    seen_by_train: bool = False  # a person looks through the training cameras, where they are few
    fewest_placed: int = 0  # pictures, besides the sweep's, that structure from motion must place
    n_fixed: int | None = None  # fixed cameras (2: or more) by which poses and times alone tell this kind


LAYOUTS = ("photographs", "recording", "recording and sweep", "recordings")


class Kind(_OfKind, StrEnum):
    """Kinds of capture. What depends on a kind asks its entry here, never its name."""

    def __new__(cls, name: str, entry: dict[str, Any] | None = None) -> "Kind":
        self = str.__new__(cls, name)
        self._value_ = name
        vars(self).update(entry or {})
        return self

    photos = (
        "photos",
        {
            "about": "a still scene",
            "found_in": ("photographs", "recording"),
            "still": True,
            "holds_out": True,
            "seen_by_train": True,
            "fewest_placed": 3,
        },
    )
    flat = (
        "flat",
        {
            "about": "one fixed camera and nothing else, in pixels",
            "found_in": ("recording",),
            "because": "; the camera stays put",
            "fixed": True,
            "sees_depth": False,
            "seen_by_train": True,
        },
    )
    tripod = (
        "tripod",
        {
            "about": "one fixed camera and a sweep",
            "found_in": ("recording and sweep",),
            "because": "; the camera stays put",
            "fixed": True,
            "fewest_placed": 1,
            "n_fixed": 1,
        },
    )
    handheld = (
        "handheld",
        {
            "about": "one camera that moves",
            "found_in": ("recording", "recording and sweep"),
            "because": "; the camera moves",
            "moving": True,
            "fewest_placed": 3,
            "n_fixed": 0,
        },
    )
    rig = (
        "rig",
        {
            "about": "several fixed cameras",
            "found_in": ("recordings",),
            "because": "; one camera that filmed from several places is --kind clips",
            "fixed": True,
            "together": True,
            "holds_out": True,
            "seen_by_train": True,
            "fewest_placed": 2,
            "n_fixed": 2,
        },
    )
    clips = (
        "clips",
        {
            "about": "one camera that filmed a steady vibration from several places, one after another",
            "found_in": ("recordings",),
            "because": ", begun one after another's end; otherwise pass --kind rig",
            "fixed": True,
            "in_turn": True,
            "holds_out": True,
            "fewest_placed": 2,
        },
    )


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
