"""Options of `tg4mm sfm` and `tg4mm convert`, and those of recordings, which `tg4mm process` has too."""

import dataclasses
import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tg4mm.core.choices import Kind
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import REQUIRED, argument, option, parse_timesteps

if TYPE_CHECKING:
    from tg4mm.capture.sfm.clip import TimeWindow
    from tg4mm.capture.sfm.scale import KnownLength

INPUT = (
    "A folder of photographs; or one video of a fixed or a moving camera, or with --fps a folder of its numbered "
    "pictures; or a folder with a video (or a folder of frames) for each fixed camera, cam_00.mp4 …, and optionally "
    "the scene at rest from all around, sweep/ (photographs) or sweep.mp4."
)
_LENGTH = tuple[str, float, float, str, float, float, float]


def keep_duplicates_option() -> Any:
    """Return the option --keep-duplicates."""
    about = (
        "Keep frames that repeat the one before them. [default: recognised duplicate frames of a video are left out, "
        "and the others keep their true times]"
    )
    return option(False, about)


def _length(given: _LENGTH | None) -> "KnownLength | None":
    from tg4mm.capture.sfm.scale import KnownLength

    return None if given is None else KnownLength(((given[:3],), (given[3:6],)), given[6])


def length_file_option() -> Any:
    """Return the option --length-file."""
    about = (
        "Scale: a known length in a JSON or YAML file, each end in one or more pictures: "
        "{metres: 0.35, points: [{000.jpg: [210, 345], 008.jpg: [180, 350]}, {000.jpg: [410, 350]}]}"
    )
    return option(None, about)


def threads_option() -> Any:
    """Return the option --threads."""
    about = "Threads; 0: all cores. With 1 thread the result is reproducible bit for bit."
    return option(-1, about, given=int, initial=0, into=_threads)


def _threads(given: int) -> int:
    if given < 0:
        raise Tg4mmError(f"--threads is {given}, expected 0 (all cores) or more")
    return given or -1


@dataclass(frozen=True)
class RecordingConfig:
    """Properties of recordings: kind, times, scale."""

    kind: Kind | None = option(
        None, f"{' '.join(f'{kind}: {kind.about}.' for kind in Kind)} [default: found from the input]"
    )
    fps: float | None = option(
        None, "Frame rate of the recordings, Hz. [default: that of the videos]", metavar="HZ"
    )
    readout_s: float | None = option(
        None,
        "Rolling shutter of fixed cameras: milliseconds from a picture's first row to its last, 8 to 25 for most "
        "phones. [default: global shutter]",
        name="--readout",
        metavar="MS",
        into=lambda ms: None if ms is None else ms / 1e3,
    )
    start_s: float = option(0.0, "Where to begin in every recording.", name="--from", unit="seconds")
    stop_s: float | None = option(
        None, "Where to end in every recording. [default: its end]", name="--until", unit="seconds"
    )
    unit_scale_m: float | None = option(None, "Scale: metres per scene unit.", unit="metres")
    baseline: tuple[str, str, float] | None = option(
        None, "Scale: names of two cameras or photographs, and their distance.", metavar="A B METRES"
    )
    length: "KnownLength | None" = option(
        None,
        "Scale: a known length in the scene. Each end is a picture's name and its pixels from the left and the upper "
        "edge, in the picture as given.",
        metavar="IMAGE X Y IMAGE X Y METRES",
        given=_LENGTH | None,
        into=_length,
    )
    keep_duplicates: bool = keep_duplicates_option()
    synchronous: bool = option(
        False,
        "One signal triggers every frame of a rig's cameras. [default: independent clocks, whose offsets are found "
        "from a steady vibration]",
    )

    @property
    def window(self) -> "TimeWindow":
        """The part of every recording that is taken."""
        from tg4mm.capture.sfm.clip import TimeWindow

        return TimeWindow(self.start_s, math.inf if self.stop_s is None else self.stop_s)


class Intrinsics(StrEnum):
    """Pictures that share a focal length and a lens."""

    shared = "shared"
    each = "each"


class Matching(StrEnum):
    """The pairs of pictures that are compared."""

    auto = "auto"
    exhaustive = "exhaustive"
    sequential = "sequential"


@dataclass(frozen=True)
class SfmConfig(RecordingConfig):
    """Settings of the reconstruction and of the dataset."""

    camera_model: str = option(
        "SIMPLE_RADIAL", "Lens model, COLMAP's name: SIMPLE_PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, …"
    )
    focal_px: float | None = option(
        None,
        "Initial focal length, pixels. [default: from EXIF, else 1.2 times the longer side]",
        metavar="PIXELS",
    )
    each: bool = option(
        False,
        "shared: one lens and zoom for all pictures. each: one for each photograph or fixed camera.",
        name="--intrinsics",
        given=Intrinsics,
        initial=Intrinsics.shared,
        into=lambda given: given is Intrinsics.each,
    )
    matching: Matching = option(
        Matching.auto,
        "Which pictures are compared with each other. auto: all pairs if there are at most 30 pictures; otherwise "
        "those that look alike, and in a long sequence neighbours. exhaustive: all pairs. sequential: neighbours.",
    )
    frames: int | None = option(
        None,
        "For a moving camera: number of sharp frames from which poses are first found. [default: one of every two, at "
        "most 80, or 60 where the scene is at rest]",
    )
    test_every: int = option(0, "Use every N-th camera as a test camera; 0: none.")
    seed: int = option(0, "Seed of COLMAP's random draws.")

    def settings(self) -> dict[str, Any]:
        """JSON values, as an earlier version wrote them: without switches that it did not know and that are off."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(SfmConfig)}
        values["length"] = None if self.length is None else dataclasses.asdict(self.length)
        if not self.keep_duplicates:
            del values["keep_duplicates"]
        return values


def sfm_config(options: RecordingConfig, length_file: Path | None) -> SfmConfig:
    """Return the settings of a reconstruction among a command's options, with the length of a file.

    Raises Tg4mmError for two lengths, and as `read_length`.
    """
    names = [f.name for f in dataclasses.fields(SfmConfig) if hasattr(options, f.name)]
    values = {name: getattr(options, name) for name in names}
    if length_file is not None:
        if options.length is not None:
            raise Tg4mmError(
                "--length and --length-file cannot be used together: both give the scene's scale"
            )
        from tg4mm.capture.sfm.scale import read_length

        values["length"] = read_length(length_file)
    return SfmConfig(**values)


@dataclass(frozen=True, kw_only=True)
class SfmOptions(SfmConfig):
    """Make a dataset from photographs or videos.

    COLMAP finds camera poses and sparse points; the times come from the videos. The dataset's pictures are undistorted.
    Its world has Z up, the scene at the origin and the cameras about 4 scene units away. A fixed camera has one pose
    for all its frames, a moving camera one for each frame.
    """

    source: Path = argument("INPUT", INPUT)
    out: Path = option(REQUIRED, "Dataset folder; an unfinished one is resumed.")
    length_file: Path | None = length_file_option()
    threads: int = threads_option()


class Layout(StrEnum):
    """Layouts of datasets; docs/export.md describes them."""

    nerfstudio = "nerfstudio"
    colmap = "colmap"


@dataclass(frozen=True, kw_only=True)
class ConvertOptions:
    """Convert a dataset to a layout that other trainers read.

    Pictures are linked, not copied, if the file system supports it. Lengths stay in scene units.
    """

    dataset: Path = argument(
        "DATASET", "A dataset of tg4mm generate or tg4mm sfm, or any other that tg4mm reads."
    )
    out: Path = option(REQUIRED, "Output folder; must be new or empty.")
    to: Layout = option(
        Layout.nerfstudio,
        "nerfstudio: transforms.json, each frame with its time. colmap: a text model of all training images, and their "
        "points.",
    )
    timesteps: list[int] | None = option(
        None, "Timesteps to write. [default: all]", metavar="A-B,C,…", given=str | None, into=parse_timesteps
    )
