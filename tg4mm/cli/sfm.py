"""`tg4mm sfm`: a dataset from photographs, a video, or several fixed cameras."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tg4mm.errors import Tg4mmError


class Intrinsics(StrEnum):
    """Who shares a focal length and a lens."""

    shared = "shared"
    each = "each"


class Matching(StrEnum):
    """Which pictures are compared."""

    auto = "auto"
    exhaustive = "exhaustive"
    sequential = "sequential"


def sfm(
    images: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGES",
            help="A folder of photographs; or one video of a moving camera; or a folder with a folder of frames, "
            "or a video, for each fixed camera (cam_00/0000.png …) and perhaps sweep/, further pictures of the "
            "scene that help to place them.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Dataset folder; an unfinished one is resumed.")],
    fps: Annotated[
        float | None,
        typer.Option(help="Frames per second of fixed cameras, Hz. [default: as their videos say]"),
    ] = None,
    camera_model: Annotated[
        str, typer.Option(help="Lens model, COLMAP's name: SIMPLE_PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, …")
    ] = "SIMPLE_RADIAL",
    focal_px: Annotated[
        float | None,
        typer.Option(
            help="First guess of the focal length, pixels. [default: EXIF, or 1.2 times the longer side]"
        ),
    ] = None,
    intrinsics: Annotated[
        Intrinsics,
        typer.Option(help="shared: one camera and zoom; each: photographs or fixed cameras differ."),
    ] = Intrinsics.shared,
    matching: Annotated[
        Matching, typer.Option(help="auto: every pair of pictures, but neighbours only in a long sequence.")
    ] = Matching.auto,
    frames: Annotated[
        int | None, typer.Option(help="Frames taken from a moving camera's video, evenly. [default: 100]")
    ] = None,
    unit_scale_m: Annotated[
        float | None, typer.Option(help="Metres per scene unit of the dataset, once you have measured it.")
    ] = None,
    baseline: Annotated[
        tuple[str, str, float] | None,
        typer.Option(
            metavar="A B METRES", help="Two cameras or photographs and their distance: gives the scale."
        ),
    ] = None,
    test_every: Annotated[
        int, typer.Option(help="Hold out every so-many-th camera as the test split; 0: none.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="Of COLMAP's random draws.")] = 0,
    threads: Annotated[
        int, typer.Option(help="Threads; 0: all cores. With 1 the result repeats bit for bit.")
    ] = 0,
) -> None:
    """Make a dataset from photographs or videos.

    COLMAP finds cameras and sparse points; train reads the result.
    The dataset's pictures are undistorted; its world has Z up, the scene in the middle and the cameras about
    4 units away. Fixed cameras get one pose each for all their frames.
    """
    if threads < 0:
        raise Tg4mmError(f"--threads is {threads}, expected 0 (all cores) or more")
    from tg4mm.sfm.reconstruct import SfmConfig, reconstruct

    config = SfmConfig(
        camera_model=camera_model,
        focal_px=focal_px,
        each=intrinsics is Intrinsics.each,
        matching=matching.value,
        frames=frames,
        fps=fps,
        unit_scale_m=unit_scale_m,
        baseline=baseline,
        test_every=test_every,
        seed=seed,
    )
    report = reconstruct(images, out, config, threads or -1)
    typer.echo(
        f"{report['placed']} of {report['pictures']} pictures placed, {report['points']} points, "
        f"{report['reprojection_error_px']:.2f} px",
        err=True,
    )
    typer.echo(str(out))
