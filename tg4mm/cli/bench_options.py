"""Options that the commands of `tg4mm bench` share."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class SameTime(StrEnum):
    """When a paper preset is trained once more, for as long as modal took."""

    needed = "needed"
    always = "always"
    never = "never"


Datasets = Annotated[
    list[Path],
    typer.Argument(
        metavar="DATASET…",
        help="Dataset folders with ground truth (tg4mm generate), or NAME=DIR where two folders have one name.",
    ),
]
Out = Annotated[
    Path, typer.Option(help="Folder for runs, figures, tables and pictures; an unfinished one is resumed.")
]
Alphas = Annotated[
    str | None,
    typer.Option(
        metavar="A,A,…", help="Magnification factors, e.g. 5,10,20,50. [default: all with ground truth]"
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="A setting of tg4mm train for every run that has it, e.g. space.iterations=500; may be repeated.",
    ),
]
Lpips = Annotated[
    list[Path] | None,
    typer.Option(help="Local file(s) with the AlexNet trunk and LPIPS heads; LPIPS is omitted without them."),
]
Banded = Annotated[
    bool,
    typer.Option(
        "--band-around-motion/--all-frequencies",
        help="Magnify the motion's frequencies ± 1.5 Hz, or all frequencies.",
    ),
]


Methods = Annotated[
    str,
    typer.Option(
        metavar="M,M,…",
        help="Some of modal, paper-tuned, paper (presets of tg4mm train), tracking, 4dgs, sc-gs, per-frame, 3dmm, "
        "phase-2d, linear-2d.",
    ),
]
Outside = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=DIR",
        help="Pictures of another method, DIR/<dataset's name>/magnified/x005/000/test/r_000.png …, or its "
        "displacements, DIR/<dataset's name>/displacement.npz; may be repeated. docs/protocol.md.",
    ),
]
MdVqa = Annotated[
    Path | None, typer.Option(help="Checkout of MD-VQA with its weights; MD-VQA is omitted without it.")
]
FastVqa = Annotated[
    Path | None, typer.Option(help="Checkout of FAST-VQA with its weights; FAST-VQA is omitted without it.")
]
VqaPython = Annotated[str, typer.Option(help="Python interpreter for MD-VQA and FAST-VQA.")]
