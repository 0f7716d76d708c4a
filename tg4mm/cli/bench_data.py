"""Commands of `tg4mm bench` on the datasets themselves: more truth, a card and checksums, and their check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def truth(
    dataset: Annotated[Path, typer.Argument(help="Dataset folder with per-pixel truth of its test views.")],
) -> None:
    """Write a dataset's truth as optical flow, part masks, occlusion and tracks of points.

    DATASET/truth/flow, parts, occlusion, parts.json, tracks.npz, of the test views, not magnified: docs/conventions.md.
    """
    from tg4mm.research.bench.truth_files import write_truth

    typer.echo("\n".join(map(str, write_truth(dataset))))


def release(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with datasets, at any depth.")],
    version: Annotated[str, typer.Option(help="Version of the data.")] = "1",
) -> None:
    """Write the card and the checksums with which datasets are passed on.

    DIR/README.md: what the datasets are; DIR/SHA256SUMS: of every file.
    """
    from tg4mm.research.bench.release import release as write

    typer.echo("\n".join(map(str, write(folder, version))))


def verify(folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with SHA256SUMS.")]) -> None:
    """Check every file of datasets against SHA256SUMS.

    A line for each file that is missing, changed or not listed; exit code 1 if there is any.
    """
    from tg4mm.research.bench.release import verify as check

    wrong = check(folder)
    typer.echo("\n".join(wrong) if wrong else f"{folder}: every file is as it was")
    if wrong:
        raise typer.Exit(1)
