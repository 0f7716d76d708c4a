"""`tg4mm demo`: the whole main job, small, from nothing."""

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[
        Path, typer.Option(help="Folder for all results; finished steps are not repeated.")
    ] = Path("demo"),
    size: Annotated[int, typer.Option(help="Width and height of the pictures, 16 to 4096 pixels.")] = 128,
) -> None:
    """Render a small scene, train, magnify and score: an example from nothing.

    Renders a vibrating scene in Blender, trains, magnifies the motion by α = 20, compares it with the ground truth,
    exports a splat file, and writes OUT/report.html.
    """
    import torch  # noqa: F401  # what lacks is said before a minute of rendering

    from tg4mm.research.demo import run_demo

    run_demo(out, size, typer.echo)
