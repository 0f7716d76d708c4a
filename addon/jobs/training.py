"""Start the core on a dataset or a video, and import the splats that it makes."""

from pathlib import Path
from typing import Any

import bpy

from dataset_gen.errors import GenerateError

from . import commands, generating
from .runner import Job, JobState

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")


def start(context: Any) -> Job:
    """Train on the dataset of the panel. Raises GenerateError or OSError, one line."""
    settings, python = context.scene.tg4mm_train, _python(context)
    dataset = generating.folder("Dataset", settings.dataset)
    if not dataset.is_dir():
        raise GenerateError(f"Dataset: folder {dataset} does not exist")
    run = dataset.parent / f"{dataset.name}_run"
    if settings.run.strip():
        run = generating.folder("Run", settings.run)
    if run == dataset or dataset in run.parents:
        raise GenerateError(f"Run {run} is inside the dataset: choose another folder")
    splat = run.parent / f"{run.name}.ply"
    steps = commands.train_steps(python, dataset, run, splat, settings.device, settings.settings.split())
    return commands.start(commands.TRAIN, steps, lambda job: _import(job, splat))


def start_after(context: Any) -> None:
    """Train on a dataset that was just generated; where it cannot be started, the panel Generate says why."""
    try:
        start(context)
    except (GenerateError, OSError, RuntimeError) as error:
        job = commands.get(commands.GENERATE)
        assert job is not None
        job.state, job.message = JobState.FAILED, f"generated, but not trained: {error}"


def start_video(context: Any, video: Path) -> Job:
    """Look at a video and train on it, in a folder beside it. Raises GenerateError or OSError, one line."""
    settings, python = context.scene.tg4mm_train, _python(context)
    if not video.is_file():
        raise GenerateError(f"Video: file {video} does not exist")
    if commands.running(commands.TRAIN):
        raise GenerateError("A training is running: wait for it or cancel it")
    out = video.with_name(f"{video.stem}-out")
    splat = out / f"{video.stem}.ply"
    steps = commands.video_steps(
        python, video, out, splat, settings.device, settings.quick, settings.settings.split()
    )
    return commands.start(commands.TRAIN, steps, lambda job: _import(job, splat))


def _python(context: Any) -> str:
    python = generating.core_python(context)
    if not python:
        raise GenerateError("Training needs the Python of the Core: set it in the preferences")
    return python


def _import(job: Job, splat: Path) -> None:
    """Import the splats of a job that has succeeded."""
    if job.state is not JobState.DONE:
        return
    manager = bpy.context.window_manager
    window = manager.windows[0] if manager.windows else None  # a timer has no window of its own
    try:
        with bpy.context.temp_override(window=window):
            bpy.ops.import_scene.tg4mm_splat("EXEC_DEFAULT", True, filepath=str(splat), sequence=False)
    except RuntimeError as error:
        reason = " ".join(str(error).removeprefix("Error: ").split())
        job.state, job.message = JobState.FAILED, f"trained, but not imported: {reason}"
        return
    job.message = f"Imported: {splat}"
