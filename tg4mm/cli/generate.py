"""`tg4mm generate`: the dataset generator, in a process of its own, which Blender takes over."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Sequence

import typer

from tg4mm.errors import Tg4mmError


def generate(context: typer.Context) -> None:
    """Render a dataset with exact ground truth, in Blender."""
    raise typer.Exit(run_generator(context.args))


def run_generator(arguments: Sequence[str]) -> int:
    """Run `python -m dataset_gen` and return its exit code, 1 if it was killed.

    Raises Tg4mmError where it is not installed.
    """
    for module, remedy in (
        ("dataset_gen", "reinstall tg4mm"),
        ("bpy", "pip install 'tg4mm[generate]' (bpy 4.5 needs Python 3.11)"),
    ):
        if importlib.util.find_spec(module) is None:
            raise Tg4mmError(f"generate needs the Python package {module}, which is not installed: {remedy}")
    command = [sys.executable, "-m", "dataset_gen", *arguments]
    with subprocess.Popen(command) as child:
        try:
            status = child.wait()
        except KeyboardInterrupt:
            child.wait()  # Ctrl+C went to it too; it ends at a whole picture
            raise
    if status < 0:
        typer.echo(
            f"tg4mm: the generator was ended by signal {-status}; the same command goes on from there",
            err=True,
        )
        return 1
    return status
