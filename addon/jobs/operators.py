"""Operators of the panels Generate and Train, from a dataset to imported splats."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty

from dataset_gen.errors import GenerateError

from .. import names
from ..reporting import reports
from . import commands, generating, objects, preview
from .runner import Job, State


class TG4MM_OT_use_selection(bpy.types.Operator):
    """Let only the selected objects move"""

    bl_idname = "tg4mm.use_selection"
    bl_label = "Move Selected Objects"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return bool(context.selected_objects)

    def execute(self, context: Any) -> set[str]:
        moving = context.scene.tg4mm_generate.moving
        moving.clear()
        for obj in context.selected_objects:
            if names.MARK not in obj and obj.type not in ("CAMERA", "LIGHT"):
                moving.add().object = obj
        if not moving:
            self.report({"ERROR"}, "No selected object can move in a dataset")
            return {"CANCELLED"}
        preview.refresh(context)
        return {"FINISHED"}


class TG4MM_OT_move_everything(bpy.types.Operator):
    """Let every object of the scene move"""

    bl_idname = "tg4mm.move_everything"
    bl_label = "Move Everything"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: Any) -> set[str]:
        context.scene.tg4mm_generate.moving.clear()
        preview.refresh(context)
        return {"FINISHED"}


class TG4MM_OT_fit_mode(bpy.types.Operator):
    """Fit positions, directions and lengths of the mode to the bounds of the moving objects, or of the active one"""

    bl_idname = "tg4mm.fit_mode"
    bl_label = "Fit to Objects"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @reports()
    def execute(self, context: Any) -> set[str]:
        corners = objects.box(objects.chosen(context), context.evaluated_depsgraph_get())
        objects.fit(context.scene.tg4mm_generate, *corners)
        preview.refresh(context)
        return {"FINISHED"}


class TG4MM_OT_mode_from_cursor(bpy.types.Operator):
    """Set this from the 3D cursor: a position to its location, a direction to its z axis, a height to its z"""

    bl_idname = "tg4mm.mode_from_cursor"
    bl_label = "From 3D Cursor"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    setting: EnumProperty(  # type: ignore[valid-type]
        items=[(name, name, "") for name in (*objects.PLACES, *objects.HEADINGS, *objects.HEIGHTS)],
        options={"HIDDEN"},
    )

    def execute(self, context: Any) -> set[str]:
        objects.from_cursor(context.scene.tg4mm_generate, self.setting, context.scene.cursor)
        preview.refresh(context)
        return {"FINISHED"}


class TG4MM_OT_preview_start(bpy.types.Operator):
    """Preview the motion in the 3D view, multiplied by Gain; the preview is not saved"""

    bl_idname = "tg4mm.preview_start"
    bl_label = "Start Preview"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return bool(context.mode == "OBJECT")

    def execute(self, context: Any) -> set[str]:
        try:
            count = preview.start(context)
        except (GenerateError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{count} object{' moves' if count == 1 else 's move'}; play the timeline")
        return {"FINISHED"}


class TG4MM_OT_preview_stop(bpy.types.Operator):
    """Remove the preview"""

    bl_idname = "tg4mm.preview_stop"
    bl_label = "Stop Preview"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: Any) -> set[str]:
        preview.stop()
        return {"FINISHED"}


class TG4MM_OT_generate(bpy.types.Operator):
    """Render a dataset of the open scene in the background, from a copy, so that you can keep working"""

    bl_idname = "tg4mm.generate"
    bl_label = "Generate"

    go_on: BoolProperty(options={"HIDDEN", "SKIP_SAVE"})  # type: ignore[valid-type]

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        if properties.go_on:
            return "Resume the stopped dataset, of the scene as it was then"
        return str(cls.__doc__)

    @classmethod
    def poll(cls, context: Any) -> bool:
        return not commands.running(commands.GENERATE)

    @reports()
    def execute(self, context: Any) -> set[str]:
        generating.generate(context, self.go_on)
        if unsaved := objects.unsaved_images():
            self.report(
                {"WARNING"}, f"Unsaved painted images, which the dataset will lack: {', '.join(unsaved[:4])}"
            )
        return {"FINISHED"}


class TG4MM_OT_train(bpy.types.Operator):
    """Fit Gaussians and their motion to the dataset in the background, then import them"""

    bl_idname = "tg4mm.train"
    bl_label = "Train and Import"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return not commands.running(commands.TRAIN)

    @reports()
    def execute(self, context: Any) -> set[str]:
        train(context)
        return {"FINISHED"}


class TG4MM_OT_cancel_job(bpy.types.Operator):
    """Stop the job; finished work is kept and the job can be resumed"""

    bl_idname = "tg4mm.cancel_job"
    bl_label = "Cancel"

    kind: EnumProperty(  # type: ignore[valid-type]
        items=[(kind, kind, "") for kind in (commands.GENERATE, commands.TRAIN)], options={"HIDDEN"}
    )

    def execute(self, context: Any) -> set[str]:
        job = commands.get(self.kind)
        if job is None or not job.running:
            return {"CANCELLED"}
        job.cancel()
        return {"FINISHED"}


def train(context: Any) -> Job:
    """Start training; the splats are imported when it ends. Raises GenerateError or OSError, one line."""
    settings = context.scene.tg4mm_train
    python = generating.core_python(context)
    if not python:
        raise GenerateError("Training needs the Python of the Core: set it in the preferences")
    dataset = _folder("Dataset", settings.dataset)
    if not dataset.is_dir():
        raise GenerateError(f"Dataset: folder {dataset} does not exist")
    run = run_folder(settings)
    if run == dataset or dataset in run.parents:
        raise GenerateError(f"Run {run} is inside the dataset: choose another folder")
    splat = run.parent / f"{run.name}.ply"
    steps = commands.train_steps(python, dataset, run, splat, settings.device, settings.settings.split())
    return commands.start(commands.TRAIN, steps, lambda job: _ended(job, splat))


def run_folder(settings: Any) -> Path:
    """Return the run folder: the chosen one, else one beside the dataset. Raises GenerateError."""
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


_CLASSES = (
    TG4MM_OT_use_selection, TG4MM_OT_move_everything, TG4MM_OT_fit_mode, TG4MM_OT_mode_from_cursor,
    TG4MM_OT_preview_start, TG4MM_OT_preview_stop, TG4MM_OT_generate, TG4MM_OT_train, TG4MM_OT_cancel_job,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(_CLASSES)
