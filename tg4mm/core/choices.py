"""Values of options and files that many parts know by name, each list written once. Needs Python's library alone."""

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

LAYOUTS = ("photographs", "recording", "recording and sweep", "recordings")


class Clock(StrEnum):
    """Relation between the times of several cameras."""

    synchronous = "synchronous"  # one clock, the same times
    independent = "independent"  # each fixed camera has its own clock
    moving = "moving"  # one camera that moves: one picture for each pose


@dataclass(frozen=True)
class CaptureKind:
    """Properties of a kind of capture."""

    about: str = ""  # for `tg4mm sfm --help`
    found_in: tuple[str, ...] = ()  # which of LAYOUTS it can lie in
    because: str = ""  # ends the sentence that says why recordings are taken for it
    still: bool = False  # the scene is; pictures have no times
    fixed: bool = False  # cameras stay put
    moving: bool = False  # one camera moves all the time
    sees_depth: bool = True  # else motion is known only across the camera's optical axis, in pixels
    together: bool = False  # several cameras film at the same time
    in_turn: bool = False  # each fixed camera has a clock, or a start of the vibration, of its own
    holds_out: bool = False  # a camera can be kept for tests
    seen_by_train: bool = False  # a person looks through the training cameras, where they are few
    fewest_placed: int = 0  # pictures, besides the sweep's, that structure from motion must place
    n_fixed: int | None = (
        None  # fixed cameras (2: or more) by which poses and times alone determine this kind
    )


# An enum of texts takes no dataclass beside str; its members get the entry's fields by `Kind.__new__`.
if TYPE_CHECKING:

    class _Fields(CaptureKind): ...
else:

    class _Fields: ...


class Kind(_Fields, StrEnum):
    """Kinds of capture. What depends on a kind asks its entry here, never its name."""

    def __new__(cls, name: str, entry: CaptureKind = CaptureKind()) -> "Kind":
        self = str.__new__(cls, name)
        self._value_ = name
        self.__dict__.update(vars(entry))
        return self

    photos = (
        "photos",
        CaptureKind(
            about="a still scene",
            found_in=("photographs", "recording"),
            still=True,
            holds_out=True,
            seen_by_train=True,
            fewest_placed=3,
        ),
    )
    flat = (
        "flat",
        CaptureKind(
            about="one fixed camera and nothing else, in pixels",
            found_in=("recording",),
            because="; the camera stays put",
            fixed=True,
            sees_depth=False,
            seen_by_train=True,
        ),
    )
    tripod = (
        "tripod",
        CaptureKind(
            about="one fixed camera and a sweep",
            found_in=("recording and sweep",),
            because="; the camera stays put",
            fixed=True,
            fewest_placed=1,
            n_fixed=1,
        ),
    )
    handheld = (
        "handheld",
        CaptureKind(
            about="one camera that moves",
            found_in=("recording", "recording and sweep"),
            because="; the camera moves",
            moving=True,
            fewest_placed=3,
            n_fixed=0,
        ),
    )
    rig = (
        "rig",
        CaptureKind(
            about="several fixed cameras",
            found_in=("recordings",),
            because="; one camera that filmed from several places is --kind clips",
            fixed=True,
            together=True,
            holds_out=True,
            seen_by_train=True,
            fewest_placed=2,
            n_fixed=2,
        ),
    )
    clips = (
        "clips",
        CaptureKind(
            about="one camera that filmed a steady vibration from several places, one after another",
            found_in=("recordings",),
            because=", each begun after the previous one ended; otherwise pass --kind rig",
            fixed=True,
            in_turn=True,
            holds_out=True,
            fewest_placed=2,
        ),
    )


class Filter(StrEnum):
    """Temporal filters (tg4mm/core/magnification.py)."""

    zero_phase = "zero-phase"
    ideal = "ideal"
    published = "published"


class MagnificationMethod(StrEnum):
    """Methods of magnification (tg4mm/core/magnification.py)."""

    modal = "modal"
    linear = "linear"
    phase = "phase"


KINDS = tuple(kind.value for kind in Kind)
FILTERS = tuple(kind.value for kind in Filter)
METHODS = tuple(method.value for method in MagnificationMethod)
