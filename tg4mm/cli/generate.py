"""`tg4mm generate`: the dataset generator."""

import typer

from tg4mm.research.generator import run_generator


def generate(context: typer.Context) -> None:
    """Render a dataset with exact ground truth, in Blender."""
    raise typer.Exit(run_generator(context.args))
