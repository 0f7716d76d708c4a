"""What `tg4mm sfm` can be told."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tg4mm.capture.sfm.clip import Window
from tg4mm.capture.sfm.scale import Length, checked_length
from tg4mm.capture.sfm.sources import FEWEST
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.values import NOT_NEGATIVE, POSITIVE, Choice, Either, Just, Maybe, Number, require

CAMERA_MODELS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
)
MATCHING = ("auto", "exhaustive", "sequential")


@dataclass(frozen=True)
class SfmConfig:
    """How poses are found and what the dataset says."""

    kind: str | None = None  # of capture; None: told from what lies on disk
    camera_model: str = "SIMPLE_RADIAL"  # COLMAP's name of the lens model; one bend is enough for most
    focal_px: float | None = (
        None  # pixels, a first guess that is refined; None: EXIF, or 1.2 × the longer side
    )
    each: bool = False  # every photograph or fixed camera has intrinsics of its own, else all share them
    matching: str = "auto"  # all pairs of few pictures, of many those alike or, of a video, neighbours
    frames: int | None = (
        None  # sharp ones that a moving camera's poses are first found from; None: one of a window
    )
    fps: float | None = None  # what was filmed at, Hz; None: as the videos say
    start_s: float = 0.0  # of every recording, seconds since its first frame
    stop_s: float | None = None
    unit_scale_m: float | None = None  # metres per scene unit
    baseline: tuple[str, str, float] | None = None  # two cameras (pictures) and their distance in metres
    length: Length | None = None  # on the thing itself
    synchronous: bool = False  # cameras of a rig were started by one signal
    test_every: int = 0  # every so-many-th camera is a test camera
    seed: int = 0

    @property
    def window(self) -> Window:
        """The part of every recording that is taken."""
        return Window(self.start_s, math.inf if self.stop_s is None else self.stop_s)


DEFAULTS = SfmConfig()


def checked(config: SfmConfig) -> SfmConfig:
    """`config`. Raises Tg4mmError on a value out of range."""

    seconds = Number(config.start_s, above=True)
    checks: dict[str, tuple[object, object]] = {
        "camera-model": (config.camera_model, Choice(*CAMERA_MODELS)),
        "focal-px": (config.focal_px, Maybe(POSITIVE)),
        "matching": (config.matching, Choice(*MATCHING)),
        "frames": (config.frames, Maybe(Number(FEWEST, whole=True))),
        "fps": (config.fps, Maybe(POSITIVE)),
        "from": (config.start_s, NOT_NEGATIVE),
        "until": (config.stop_s, Maybe(seconds)),
        "unit-scale-m": (config.unit_scale_m, Maybe(POSITIVE)),
        "baseline": (config.baseline[2] if config.baseline else None, Maybe(POSITIVE)),
        "test-every": (config.test_every, Either(Just(0), Number(2, whole=True))),
        "seed": (config.seed, Number(0, 2**31 - 1, whole=True)),
    }
    for name, (value, rule) in checks.items():
        require(f"--{name}", value, rule, Tg4mmError)
    scales = {
        "--unit-scale-m": config.unit_scale_m,
        "--baseline": config.baseline,
        "--length": config.length and checked_length(config.length),
    }
    given = [name for name, value in scales.items() if value is not None]
    if len(given) > 1:
        raise Tg4mmError(f"{' and '.join(given)} exclude each other: each says how large the scene is")
    return config
