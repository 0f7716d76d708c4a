"""`tg4mm convert`: a dataset in a layout that other trainers read."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.export import parse_timesteps


class Layout(StrEnum):
    """Layouts of datasets; docs/export.md describes them."""

    nerfstudio = "nerfstudio"
    colmap = "colmap"


def convert(
    dataset: Annotated[
        Path,
        typer.Argument(
            metavar="DATASET", help="A dataset of tg4mm generate or tg4mm sfm, or any other that tg4mm reads."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Output folder; must be new or empty.")],
    to: Annotated[
        Layout,
        typer.Option(
            help="nerfstudio: transforms.json, each frame with its time. "
            "colmap: a text model of all training images, and their points."
        ),
    ] = Layout.nerfstudio,
    timesteps: Annotated[
        str | None, typer.Option(metavar="A-B,C,…", help="Timesteps to write. [default: all]")
    ] = None,
) -> None:
    """Convert a dataset to a layout that other trainers read.

    Pictures are linked, not copied, where the file system can. Lengths stay in scene units.
    """
    wanted = parse_timesteps(timesteps)
    from tg4mm.capture import load_capture
    from tg4mm.capture.convert import at_timesteps, split_of, write_colmap, write_nerfstudio

    train = at_timesteps(load_capture(dataset), wanted)
    if to is Layout.colmap:
        write_colmap(train, out)
    else:
        test = split_of(dataset, "test")
        write_nerfstudio([train] if test is None else [train, at_timesteps(test, wanted)], out)
    typer.echo(str(out))
