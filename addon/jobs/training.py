"""From a dataset to splats in the scene: train, export, import."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import bpy

from ..generator.dataset_gen.errors import GenerateError
from . import background, commands, generating
from .runner import Job, State


def train(context: Any) -> Job:
    """Start training; the splats are imported when it ends. Raises GenerateError or OSError, one line."""
    settings = context.scene.tg4mm_train
    python = generating.core_python(context)
    if not python:
        raise GenerateError("Python of the Core is not named in the preferences: training needs it")
    dataset = _folder("Dataset", settings.dataset)
    if not dataset.is_dir():
        raise GenerateError(f"Dataset: there is no folder {dataset}")
    run = run_folder(settings)
    if run == dataset or dataset in run.parents:
        raise GenerateError(f"Run {run} lies in the dataset: choose another folder")
    splat = run.parent / f"{run.name}.ply"
    steps = commands.train_steps(python, dataset, run, splat, settings.device, settings.settings.split())
    return background.start(background.TRAIN, steps, lambda job: _ended(job, splat))


def run_folder(settings: Any) -> Path:
    """The folder of the run: the one chosen, else one beside the dataset. Raises GenerateError."""
    if settings.run.strip():
        return _folder("Run", settings.run)
    dataset = _folder("Dataset", settings.dataset)
    return dataset.parent / f"{dataset.name}_run"


def _folder(what: str, text: str) -> Path:
    if not text.strip():
        raise GenerateError(f"{what} is empty: choose a folder")
    if text.startswith("//") and not bpy.data.filepath:
        raise GenerateError(f"{what} {text} lies beside the .blend file, which is not saved yet")
    return Path(os.path.abspath(bpy.path.abspath(text)))


def _ended(job: Job, splat: Path) -> None:
    """Import what was trained, as File > Import does, with an undo step."""
    if job.state is not State.DONE:
        return
    manager = bpy.context.window_manager
    window = manager.windows[0] if manager.windows else None  # a timer has no window of its own
    try:
        with bpy.context.temp_override(window=window):
            bpy.ops.import_scene.tg4mm_splat("EXEC_DEFAULT", True, filepath=str(splat), sequence=False)
    except RuntimeError as error:
        reason = " ".join(str(error).removeprefix("Error: ").split())
        job.state, job.message = State.FAILED, f"trained, but not imported: {reason}"
        return
    job.message = f"Imported: {splat}"
