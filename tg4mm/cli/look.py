"""`tg4mm look`: what vibrates in a video, in seconds."""

import math
from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.regions import RegionsOption, read_drawn
from tg4mm.cli.sfm import KeepDuplicatesOption
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.values import NOT_NEGATIVE, POSITIVE, Maybe, require


def look(
    video: Annotated[
        Path,
        typer.Argument(
            metavar="VIDEO",
            help="A video of a camera that stands still, or a folder of numbered pictures.",
        ),
    ],
    fps: Annotated[
        float | None,
        typer.Option(
            help="Pictures a second at which it was filmed, where the file says another rate (slow motion) or none "
            "(a folder). [default: the file's own times]"
        ),
    ] = None,
    readout: Annotated[
        float | None,
        typer.Option(
            metavar="MS",
            help="Rolling shutter: milliseconds from a picture's first row to its last. [default: all rows are taken "
            "to be read at once]",
        ),
    ] = None,
    start: Annotated[
        float, typer.Option("--from", metavar="SECONDS", help="Where to begin in the video.")
    ] = 0.0,
    until: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Where to stop, seconds from the video's beginning. [default: its end]"
        ),
    ] = None,
    keep_duplicates: KeepDuplicatesOption = False,
    regions: RegionsOption = None,
    out: Annotated[Path | None, typer.Option(help="Folder for look.html, look.json and look.png.")] = None,
    png: Annotated[
        Path | None,
        typer.Option(
            help="The picture. [default: OUT/look.png, without --out NAME-look.png in the current folder]"
        ),
    ] = None,
) -> None:
    """Tell what vibrates in a video of a fixed camera, before any model is fitted: seconds.

    The picture is cut into cells, the shift of every cell is measured in every picture (pixels), and lines (Hz) are
    tested region by region, the strongest first. Printed are frequencies and amplitudes with their standard deviations
    and where they are, what moves by itself, what the light does, how small a motion would be found, what the record
    cannot tell, and the next command. A picture shows the regions on the first frame and the composite spectrum.
    """
    if fps is not None and not 0 < fps < 1e6:
        raise Tg4mmError(f"--fps is {fps:g}; expected pictures a second, more than 0")
    require("--readout", readout, Maybe(NOT_NEGATIVE), Tg4mmError)
    if png is not None and png.suffix.lower() != ".png":
        raise Tg4mmError(f"--png {png}: expected a name that ends in .png")
    require("--until", until, Maybe(POSITIVE), Tg4mmError)
    stop = math.inf if until is None else until
    if not 0 <= start < stop:
        raise Tg4mmError(f"--from {start:g}{'' if until is None else f' --until {until:g}'}: holds nothing")
    if video.is_dir() and (start or until is not None):
        raise Tg4mmError("--from and --until are of videos; leave out files of the folder")
    from tg4mm.capture.look import look as looked
    from tg4mm.capture.look.rows import with_rows
    from tg4mm.capture.sfm.clip import Window
    from tg4mm.capture.video import RECORDING_SUFFIXES, is_turned
    from tg4mm.show.look import Words, write_json_file, write_page, write_picture

    if out is not None and out.exists() and not out.is_dir():
        raise Tg4mmError(f"--out {out}: is a file; expected a folder")
    window = Window(start, stop)
    if readout and video.is_file() and video.suffix.lower() in RECORDING_SUFFIXES and is_turned(video):
        raise Tg4mmError(
            f"--readout is for pictures whose rows are read from top to bottom, but those of {video.name} are turned "
            "when they are shown"
        )
    drawn = read_drawn(regions)
    found = looked(video, fps, window, drawn, keep_duplicates)
    if (readout or 0) > (frame_ms := 1e3 / found.rate):
        raise Tg4mmError(
            f"--readout is {readout:g}, expected at most the {frame_ms:.4g} ms of a frame of {video.name}"
        )
    words = Words(with_rows(found, (readout or 0) / 1e3), video, fps, window, drawn, regions, keep_duplicates)
    target = png or (Path(f"{video.resolve().stem}-look.png") if out is None else out / "look.png")
    for folder in (out, target.parent):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    write_picture(words, target)
    if out is not None:
        write_json_file(words, out / "look.json")
        write_page(words, out / "look.html")
    shown = target if out is None else out / "look.html"
    typer.echo("\n".join([*words.lines(), str(shown)]))
