"""The option --regions, which look, measure, process and view share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tg4mm.core.regions import Regions

RegionsOption = Annotated[
    Path | None,
    typer.Option("--regions", metavar="FILE", help="Regions and a scale drawn with tg4mm view (JSON)."),
]


def read_drawn(path: Path | None) -> Regions | None:
    """The file's. Raises RegionError."""
    from tg4mm.core.regions import read_regions

    return None if path is None else read_regions(path)
