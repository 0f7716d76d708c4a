"""Operators of the panels Generate and Train, from a dataset to imported splats."""

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty

from dataset_gen.errors import GenerateError

from .. import names
from ..declare import Declared
from . import commands, generating, objects
from .runner import Job, State

_ui = Declared()
register, unregister = _ui.register, _ui.unregister


@_ui.operator("Move Selected Objects", poll=lambda context: context.selected_objects)
def use_selection(operator: Any, context: Any) -> None:
    """Let only the selected objects move"""
    moving = context.scene.tg4mm_generate.moving
    moving.clear()
    for obj in context.selected_objects:
        if names.MARK not in obj and obj.type not in ("CAMERA", "LIGHT"):
            moving.add().object = obj
    if not moving:
        raise GenerateError("No selected object can move in a dataset")


@_ui.operator("Move Everything")
def move_everything(operator: Any, context: Any) -> None:
    """Let every object of the scene move"""
    context.scene.tg4mm_generate.moving.clear()


@_ui.operator("Fit to Objects")
def fit_mode(operator: Any, context: Any) -> None:
    """Fit positions, directions and lengths of the mode to the bounds of the moving objects, or of the active one"""
    corners = objects.box(objects.chosen(context), context.evaluated_depsgraph_get())
    objects.fit(context.scene.tg4mm_generate, *corners)


_FIELDS = [(name, name, "") for name in (*objects.PLACES, *objects.HEADINGS, *objects.HEIGHTS)]


@_ui.operator("From 3D Cursor", setting=EnumProperty(items=_FIELDS, options={"HIDDEN"}))
def mode_from_cursor(operator: Any, context: Any) -> None:
    """Set this from the 3D cursor: a position to its location, a direction to its z axis, a height to its z"""
    objects.from_cursor(context.scene.tg4mm_generate, operator.setting, context.scene.cursor)


def _about_generate(context: Any, properties: Any) -> str:
    return (
        "Resume the stopped dataset, of the scene as it was then"
        if properties.go_on
        else str(generate.__doc__)
    )


@_ui.operator(
    "Generate", lambda context: not commands.running(commands.GENERATE), undo=False, about=_about_generate,
    go_on=BoolProperty(options={"HIDDEN", "SKIP_SAVE"}),
)  # fmt: skip
def generate(operator: Any, context: Any) -> None:
    """Render a dataset of the open scene in the background, from a copy, so that you can keep working"""
    generating.generate(context, operator.go_on)
    if unsaved := objects.unsaved_images():
        text = f"Unsaved painted images, which the dataset will lack: {', '.join(unsaved[:4])}"
        operator.report({"WARNING"}, text)


@_ui.operator("Train and Import", lambda context: not commands.running(commands.TRAIN), undo=False)
def train(operator: Any, context: Any) -> None:
    """Fit Gaussians and their motion to the dataset in the background, then import them"""
    settings = context.scene.tg4mm_train
    python = generating.core_python(context)
    if not python:
        raise GenerateError("Training needs the Python of the Core: set it in the preferences")
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
    commands.start(commands.TRAIN, steps, lambda job: _import(job, splat))


_JOBS = [(kind, kind, "") for kind in (commands.GENERATE, commands.TRAIN)]


@_ui.operator("Cancel", undo=False, kind=EnumProperty(items=_JOBS, options={"HIDDEN"}))
def cancel_job(operator: Any, context: Any) -> None:
    """Stop the job; finished work is kept and the job can be resumed"""
    job = commands.get(operator.kind)
    if job is not None:
        job.cancel()


def _import(job: Job, splat: Path) -> None:
    """Import the splats of a job that has succeeded."""
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
