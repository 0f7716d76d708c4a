"""File > Import > TG4MM splat."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from . import scene
from .core.errors import SplatFileError
from .core.splatfile import read_splat


class IMPORT_SCENE_OT_tg4mm_splat(bpy.types.Operator, ImportHelper):
    """Import Gaussian splats with their motion as points that move"""

    bl_idname = "import_scene.tg4mm_splat"
    bl_label = "Import TG4MM splat"
    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012

    filename_ext = ".ply"
    filter_glob: StringProperty(default="*.ply", options={"HIDDEN"})  # type: ignore[valid-type]
    timeline: BoolProperty(  # type: ignore[valid-type]
        name="Set Timeline",
        description="Take frame rate and frame range from a file with motion",
        default=True,
    )

    def execute(self, context: Any) -> set[str]:
        path = Path(self.filepath)
        try:
            splat = read_splat(path)
        except SplatFileError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        obj = scene.make_object(splat, path.stem, context.collection)
        if self.timeline:
            scene.set_timeline(context.scene, splat)
        for other in context.selected_objects:
            other.select_set(False)
        obj.select_set(True)
        context.view_layer.objects.active = obj
        self.report({"INFO"}, f"{len(splat)} Gaussians, {splat.n_modes} modes")
        return {"FINISHED"}


def _menu(self: Any, context: Any) -> None:
    self.layout.operator(IMPORT_SCENE_OT_tg4mm_splat.bl_idname, text="TG4MM splat (.ply)")


def register() -> None:
    bpy.utils.register_class(IMPORT_SCENE_OT_tg4mm_splat)
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(IMPORT_SCENE_OT_tg4mm_splat)
