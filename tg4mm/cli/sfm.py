"""`tg4mm sfm`: a dataset from photographs or videos."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tg4mm.core.choices import Kind
from tg4mm.core.errors import Tg4mmError

if TYPE_CHECKING:
    from tg4mm.capture.sfm.scale import Length


class Intrinsics(StrEnum):
    """Who shares a focal length and a lens."""

    shared = "shared"
    each = "each"


class Matching(StrEnum):
    """Which pictures are compared."""

    auto = "auto"
    exhaustive = "exhaustive"
    sequential = "sequential"


InputArgument = Annotated[
    Path,
    typer.Argument(
        metavar="INPUT",
        help="A folder of photographs; or one video of a fixed or a moving camera, or with --fps a folder of its "
        "numbered pictures; or a folder with a video (or a folder of frames) for each fixed camera, cam_00.mp4 …, and "
        "optionally the scene at rest from all around, sweep/ (photographs) or sweep.mp4.",
    ),
]
KindOption = Annotated[
    Kind | None,
    typer.Option(
        help=f"{' '.join(f'{kind}: {kind.about}.' for kind in Kind)} [default: found from the input]"
    ),
]
FpsOption = Annotated[
    float | None, typer.Option(help="Frame rate of the recordings, Hz. [default: that of the videos]")
]
ReadoutOption = Annotated[
    float | None,
    typer.Option(
        metavar="MS",
        help="Rolling shutter of fixed cameras: milliseconds from a picture's first row to its last, 8 to 25 of most "
        "phones. [default: all rows are taken to be read at once]",
    ),
]
FromOption = Annotated[
    float, typer.Option("--from", metavar="SECONDS", help="Where to begin in every recording.")
]
UntilOption = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Where to end in every recording. [default: its end]")
]
KeepDuplicatesOption = Annotated[
    bool,
    typer.Option(
        "--keep-duplicates",
        help="Keep frames that repeat the one before them. [default: a video's duplicate frames are left out, where "
        "they are recognised, and the others have the times at which they were taken]",
    ),
]
ScaleOption = Annotated[float | None, typer.Option(help="Scale: metres per scene unit.")]
BaselineOption = Annotated[
    tuple[str, str, float] | None,
    typer.Option(
        metavar="A B METRES", help="Scale: names of two cameras or photographs, and their distance."
    ),
]
LengthOption = Annotated[
    tuple[str, float, float, str, float, float, float] | None,
    typer.Option(
        metavar="IMAGE X Y IMAGE X Y METRES",
        help="Scale: a known length in the scene. Each end is a picture's name and its pixels from the left and "
        "the upper edge, in the picture as given.",
    ),
]
LengthFileOption = Annotated[
    Path | None,
    typer.Option(
        help="Scale: a known length in a JSON or YAML file, each end in one or more pictures: "
        "{metres: 0.35, points: [{000.jpg: [210, 345], 008.jpg: [180, 350]}, {000.jpg: [410, 350]}]}"
    ),
]
SynchronousOption = Annotated[
    bool,
    typer.Option(
        "--synchronous",
        help="One signal started all cameras of a rig. [default: every camera has a clock of its own; offsets are "
        "found from a steady vibration]",
    ),
]
ThreadsOption = Annotated[
    int, typer.Option(help="Threads; 0: all cores. With 1 thread the result is reproducible bit for bit.")
]


def sfm(
    images: InputArgument,
    out: Annotated[Path, typer.Option(help="Dataset folder; an unfinished one is resumed.")],
    kind: KindOption = None,
    fps: FpsOption = None,
    readout: ReadoutOption = None,
    start: FromOption = 0.0,
    until: UntilOption = None,
    keep_duplicates: KeepDuplicatesOption = False,
    camera_model: Annotated[
        str, typer.Option(help="Lens model, COLMAP's name: SIMPLE_PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, …")
    ] = "SIMPLE_RADIAL",
    focal_px: Annotated[
        float | None,
        typer.Option(
            help="Initial focal length, pixels. [default: from EXIF, else 1.2 times the longer side]"
        ),
    ] = None,
    intrinsics: Annotated[
        Intrinsics,
        typer.Option(
            help="shared: one lens and zoom for all pictures. each: one for each photograph or fixed camera."
        ),
    ] = Intrinsics.shared,
    matching: Annotated[
        Matching,
        typer.Option(
            help="Which pictures are compared. auto: every pair of up to 30 pictures; of more, those that look alike; "
            "in a long sequence, neighbours."
        ),
    ] = Matching.auto,
    frames: Annotated[
        int | None,
        typer.Option(
            help="Number of sharp frames of a moving camera to begin with. [default: one of every two, "
            "80 at most]"
        ),
    ] = None,
    unit_scale_m: ScaleOption = None,
    baseline: BaselineOption = None,
    length: LengthOption = None,
    length_file: LengthFileOption = None,
    synchronous: SynchronousOption = False,
    test_every: Annotated[int, typer.Option(help="Use every N-th camera as a test camera; 0: none.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of COLMAP's random draws.")] = 0,
    threads: ThreadsOption = 0,
) -> None:
    """Make a dataset from photographs or videos.

    COLMAP finds camera poses and sparse points; the times come from the videos. The dataset's pictures are undistorted.
    Its world has Z up, the scene at the origin and the cameras about 4 scene units away. A fixed camera has one pose
    for all its frames, a moving camera one for each frame.
    """
    if threads < 0:
        raise Tg4mmError(f"--threads is {threads}, expected 0 (all cores) or more")
    from tg4mm.capture.sfm.reconstruct import SfmConfig, reconstruct

    config = SfmConfig(
        kind=None if kind is None else kind.value,
        camera_model=camera_model,
        focal_px=focal_px,
        each=intrinsics is Intrinsics.each,
        matching=matching.value,
        frames=frames,
        fps=fps,
        readout_s=None if readout is None else readout / 1e3,
        start_s=start,
        stop_s=until,
        unit_scale_m=unit_scale_m,
        baseline=baseline,
        length=length_of(length, length_file),
        test_every=test_every,
        keep_duplicates=keep_duplicates,
        synchronous=synchronous,
        seed=seed,
    )
    report = reconstruct(images, out, config, threads or -1)
    if "placed" in report:
        typer.echo(
            f"{report['placed']} of {report['pictures']} pictures placed, {report['points']} points, "
            f"{report['reprojection_error_px']:.2f} px",
            err=True,
        )
    if "length" in report:
        found = report["length"]
        ends = " and ".join(f"({', '.join(f'{x:.4f}' for x in point)})" for point in found["points"])
        typer.echo(
            f"length: {found['metres']:g} m between {ends} is {found['units']:.5g} units, "
            f"± {found['uncertainty_percent']:.2g} %",
            err=True,
        )
    typer.echo(str(out))


def length_of(
    given: tuple[str, float, float, str, float, float, float] | None, path: Path | None
) -> Length | None:
    """The known length that was given, in either way. Raises Tg4mmError for two, and as `read_length`."""
    from tg4mm.capture.sfm.scale import Length, read_length

    if given is not None and path is not None:
        raise Tg4mmError("--length and --length-file exclude each other: both say how large the scene is")
    if path is not None:
        return read_length(path)
    if given is None:
        return None
    first, second, metres = given[:3], given[3:6], given[6]
    return Length(((first,), (second,)), metres)
