"""The command lines of the background programs; plain Python, no Blender."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import dataset_gen

from .runner import Step

GENERATOR = Path(str(dataset_gen.__file__)).with_name("blender_main.py")


@dataclass(frozen=True)
class Host:
    """What runs the generator."""

    command: tuple[str, ...]  # before the generator's own arguments
    is_core: bool  # whether it is the environment that tg4mm is installed in


def core_host(python: str) -> Host:
    """The environment that tg4mm is installed in."""
    return Host((python, "-m", "dataset_gen"), True)


def blender_host(blender: str, python: str) -> Host:
    """This Blender, or where it is a Python module, `blender` "", the Python that it is a module of."""
    if not blender:
        return Host((python, str(GENERATOR), "--"), False)
    start = (blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python")
    return Host((*start, str(GENERATOR), "--"), False)


def generate_steps(
    host: Host, blend: Path, motion: Path, out: Path, options: Mapping[str, str | int | float]
) -> list[Step]:
    """`options`: of the generator, without their dashes."""
    arguments = [text for name, value in options.items() for text in (f"--{name}", _text(value))]
    files = ("--blend", str(blend), "--motion", str(motion), "--out", str(out))
    return [Step("reading the scene", (*host.command, *files, *arguments))]


def train_steps(
    python: str, dataset: Path, run: Path, splat: Path, device: str, settings: Sequence[str] = ()
) -> list[Step]:
    """Train on a dataset, then write the splat file. `settings`: "space.iterations=3000" and the like."""
    sets = [text for pair in settings for text in ("--set", pair)]
    core = (python, "-m", "tg4mm")
    train = (*core, "train", str(dataset), "--out", str(run), "--device", device, *sets)
    export = (*core, "export", str(run), "--out", str(splat), "--format", "ply")
    return [Step("starting to train", train), Step("writing the splats", export)]


def environment() -> dict[str, str]:
    """This process's, for a Python of its own: output at once and in UTF-8, what happens as events
    (tg4mm/core/events.py), nothing taken from the folder it is in."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "PYTHONSTARTUP")}
    return kept | {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "PYTHONSAFEPATH": "1", "TG4MM_EVENTS": "json"}


def _text(value: str | int | float) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)
