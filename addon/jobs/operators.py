"""Operators of the panels Generate and Train: each reads settings, calls a plain function and reports."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty

from .. import names
from ..generator.dataset_gen.errors import GenerateError
from ..io import saving
from . import background, generating, objects, placing, preview, training


class TG4MM_OT_use_selection(bpy.types.Operator):
    """Let the selected objects move, and all others stand still"""

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
    """Set places, directions and lengths of the mode by the box around the moving objects, or the active one"""

    bl_idname = "tg4mm.fit_mode"
    bl_label = "Fit to Objects"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: Any) -> set[str]:
        try:
            corners = objects.box(placing.chosen(context), context.evaluated_depsgraph_get())
            placing.fit(context.scene.tg4mm_generate, *corners)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        preview.refresh(context)
        return {"FINISHED"}


class TG4MM_OT_mode_from_cursor(bpy.types.Operator):
    """Set this to the 3D cursor: a place to its location, a direction to its z axis, a height to its z"""

    bl_idname = "tg4mm.mode_from_cursor"
    bl_label = "From 3D Cursor"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    setting: EnumProperty(  # type: ignore[valid-type]
        items=[(name, name, "") for name in (*placing.PLACES, *placing.HEADINGS, *placing.HEIGHTS)],
        options={"HIDDEN"},
    )

    def execute(self, context: Any) -> set[str]:
        placing.from_cursor(context.scene.tg4mm_generate, self.setting, context.scene.cursor)
        preview.refresh(context)
        return {"FINISHED"}


class TG4MM_OT_preview_start(bpy.types.Operator):
    """Show in the 3D view how the scene would move, so many times as far as Gain says; nothing of it is saved"""

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
    """Take the preview away"""

    bl_idname = "tg4mm.preview_stop"
    bl_label = "Stop Preview"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: Any) -> set[str]:
        preview.stop()
        return {"FINISHED"}


class TG4MM_OT_generate(bpy.types.Operator):
    """Render a dataset of the open scene in the background, from a copy: you can go on working"""

    bl_idname = "tg4mm.generate"
    bl_label = "Generate"

    go_on: BoolProperty(options={"HIDDEN", "SKIP_SAVE"})  # type: ignore[valid-type]

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        if properties.go_on:
            return "Go on with the dataset that was stopped, of the scene as it was then"
        return str(cls.__doc__)

    @classmethod
    def poll(cls, context: Any) -> bool:
        return not background.running(background.GENERATE)

    def execute(self, context: Any) -> set[str]:
        try:
            generating.generate(context, self.go_on)
        except GenerateError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except OSError as error:
            self.report({"ERROR"}, saving.one_line(error, "used"))
            return {"CANCELLED"}
        if unsaved := objects.unsaved_images():
            self.report({"WARNING"}, f"Not saved, so without what was painted: {', '.join(unsaved[:4])}")
        return {"FINISHED"}


class TG4MM_OT_train(bpy.types.Operator):
    """Fit Gaussians and their motion to the dataset in the background, then import them"""

    bl_idname = "tg4mm.train"
    bl_label = "Train and Import"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return not background.running(background.TRAIN)

    def execute(self, context: Any) -> set[str]:
        try:
            training.train(context)
        except GenerateError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except OSError as error:
            self.report({"ERROR"}, saving.one_line(error, "used"))
            return {"CANCELLED"}
        return {"FINISHED"}


class TG4MM_OT_cancel_job(bpy.types.Operator):
    """Stop it; what is finished stays, and it can go on from there"""

    bl_idname = "tg4mm.cancel_job"
    bl_label = "Cancel"

    kind: EnumProperty(  # type: ignore[valid-type]
        items=[(kind, kind, "") for kind in (background.GENERATE, background.TRAIN)], options={"HIDDEN"}
    )

    def execute(self, context: Any) -> set[str]:
        job = background.get(self.kind)
        if job is None or not job.running:
            return {"CANCELLED"}
        job.cancel()
        return {"FINISHED"}


_CLASSES = (
    TG4MM_OT_use_selection,
    TG4MM_OT_move_everything,
    TG4MM_OT_fit_mode,
    TG4MM_OT_mode_from_cursor,
    TG4MM_OT_preview_start,
    TG4MM_OT_preview_stop,
    TG4MM_OT_generate,
    TG4MM_OT_train,
    TG4MM_OT_cancel_job,
)


register, unregister = bpy.utils.register_classes_factory(_CLASSES)
