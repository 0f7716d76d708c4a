"""`tg4mm export`: a run in a format that other programs read."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tg4mm.errors import Tg4mmError


class Format(StrEnum):
    """File formats; docs/conventions.md describes them."""

    ply = "ply"
    ply_sequence = "ply-sequence"


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder made by tg4mm train.")],
    out: Annotated[Path, typer.Option(help="The file to write, or for a sequence the folder.")],
    format: Annotated[
        Format,
        typer.Option(
            help="ply: the splat file, a 3DGS PLY with motion riding along. "
            "ply-sequence: a static 3DGS PLY for every timestep."
        ),
    ] = Format.ply,
    alpha: Annotated[
        float | None, typer.Option(help="Magnification of a sequence: (1 + alpha) δ. [default: 0]")
    ] = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LO HI", help="Magnified modes of a sequence, Hz. [default: all]"),
    ] = None,
) -> None:
    """Write a run as files for viewers and for Blender.

    Lengths are in scene units.
    """
    if format is Format.ply and (alpha is not None or band is not None):
        raise Tg4mmError(
            "--alpha and --band belong to --format ply-sequence; a splat file holds the motion itself"
        )
    from tg4mm.export import export_ply, export_ply_sequence
    from tg4mm.runs import Run

    opened = Run.open(run)
    if format is Format.ply:
        export_ply(opened, out)
    else:
        export_ply_sequence(opened, out, alpha or 0.0, band)
    typer.echo(str(out))
