"""Operators of the panels Generate and Train, from a dataset or a video to imported splats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from dataset_gen.errors import GenerateError

from .. import names
from ..declare import Declared, reports
from . import commands, generating, objects, training

_ui = Declared()
register, unregister = _ui.register, _ui.unregister
_FIELDS = [(name, name, "") for name in (*objects.PLACES, *objects.HEADINGS, *objects.HEIGHTS)]
_JOBS = [(kind, kind, "") for kind in (commands.GENERATE, commands.TRAIN)]


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


@_ui.operator("From 3D Cursor", setting=EnumProperty(items=_FIELDS, options={"HIDDEN"}))
def mode_from_cursor(operator: Any, context: Any) -> None:
    """Set this from the 3D cursor: a position to its location, a direction to its z axis, a height to its z"""
    objects.from_cursor(context.scene.tg4mm_generate, operator.setting, context.scene.cursor)


def _about_generate(context: Any, properties: Any) -> str:
    return (
        "Resume the stopped dataset, with the scene as it was then"
        if properties.go_on
        else str(generate.__doc__)
    )


@_ui.operator(
    "Generate", lambda context: not commands.running(commands.GENERATE), undo=False, about=_about_generate,
    go_on=BoolProperty(options={"HIDDEN", "SKIP_SAVE"}),
)  # fmt: skip
def generate(operator: Any, context: Any) -> None:
    """Render a dataset of the open scene in the background, from a copy, so that you can keep working"""
    generating.generate(context, operator.go_on, training.start_after)
    if unsaved := objects.unsaved_images():
        text = f"Unsaved painted images, which the dataset will lack: {', '.join(unsaved[:4])}"
        operator.report({"WARNING"}, text)


@_ui.operator("Train and Import", lambda context: not commands.running(commands.TRAIN), undo=False)
def train(operator: Any, context: Any) -> None:
    """Fit Gaussians and their motion to the dataset in the background, then import them"""
    training.start(context)


class IMPORT_SCENE_OT_tg4mm_video(bpy.types.Operator, ImportHelper):
    """Look at a video, train splats on it in the background, and import them"""

    bl_idname = "import_scene.tg4mm_video"
    bl_label = "Train Splats from Video"

    filter_glob: StringProperty(  # type: ignore[valid-type]
        default=";".join(f"*{ending}" for ending in training.VIDEOS), options={"HIDDEN"}
    )
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def invoke(self, context: Any, event: Any) -> set[str]:
        return self.execute(context) if self.filepath else ImportHelper.invoke(self, context, event)

    @reports("read")
    def execute(self, context: Any) -> set[str]:
        training.start_video(context, Path(bpy.path.abspath(self.filepath)))
        self.report(
            {"INFO"}, "Training in the background: the sidebar (N), TG4MM, Train, shows how far it is"
        )
        return {"FINISHED"}


class IO_FH_tg4mm_video(bpy.types.FileHandler):
    bl_idname = "IO_FH_tg4mm_video"
    bl_label = "TG4MM: Splats from Video"
    bl_import_operator = IMPORT_SCENE_OT_tg4mm_video.bl_idname
    bl_file_extensions = ";".join(training.VIDEOS)

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


_ui.classes += [IMPORT_SCENE_OT_tg4mm_video, IO_FH_tg4mm_video]


@_ui.operator("Cancel", undo=False, kind=EnumProperty(items=_JOBS, options={"HIDDEN"}))
def cancel_job(operator: Any, context: Any) -> None:
    """Stop the job; finished work is kept and the job can be resumed"""
    job = commands.get(operator.kind)
    if job is not None:
        job.cancel()
