"""`tg4mm export`: a run in a format that other programs read."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.magnify import (
    BandOption,
    EmptyBandOption,
    FilterOption,
    MethodOption,
    check_magnified,
    check_paired,
    known_bands,
    paired,
    parse_bands,
    temporal_filter,
    warn_too_far,
)
from tg4mm.errors import Tg4mmError


class Format(StrEnum):
    """File formats; docs/conventions.md describes them."""

    ply = "ply"
    ply_sequence = "ply-sequence"
    html = "html"


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder made by tg4mm train.")],
    out: Annotated[Path, typer.Option(help="The file to write, or for a sequence the folder.")],
    format: Annotated[
        Format,
        typer.Option(
            help="ply: the splat file, a 3DGS PLY with motion riding along. "
            "ply-sequence: a static 3DGS PLY for every timestep. "
            "html: one page that plays the run in any browser (docs/web.md)."
        ),
    ] = Format.ply,
    alpha: Annotated[
        list[float] | None,
        typer.Option(help="Magnification of a sequence: (1 + alpha) δ, once for each --band. [default: 0]"),
    ] = None,
    band: BandOption = None,
    method: MethodOption = None,
    filter: FilterOption = None,
    allow_empty_band: EmptyBandOption = False,
) -> None:
    """Write a run as files for viewers and for Blender.

    Lengths are in scene units.
    """
    given = {"--method": method is not None, "--filter": filter is not None}
    if format is not Format.ply_sequence and (alpha or band or any(given.values())):
        named = (
            "--alpha and --band" if alpha or band else next(name for name, there in given.items() if there)
        )
        belong = "belong" if alpha or band else "belongs"
        holder = "a page" if format is Format.html else "a splat file"
        raise Tg4mmError(f"{named} {belong} to --format ply-sequence; {holder} holds the motion itself")
    alphas, asked = alpha or [0.0], parse_bands(band)
    check_paired(alphas, asked)
    chosen_filter = temporal_filter(filter, asked)
    from tg4mm.export import export_ply, export_ply_sequence
    from tg4mm.render import RenderRequest
    from tg4mm.runs import Run

    opened = Run.open(run)
    if format is Format.ply:
        export_ply(opened, out)
    elif format is Format.html:
        from tg4mm.web.write import export_html

        export_html(opened, out)
    else:
        chosen = None if method is None else method.value
        magnified = paired(alphas, known_bands(opened, asked))
        request = RenderRequest(method=chosen, filter=chosen_filter, **magnified)
        check_magnified(opened, request.checked().plan, allow_empty_band)
        warn_too_far(opened, request.plan)
        export_ply_sequence(opened, out, request=request)
    typer.echo(str(out))
