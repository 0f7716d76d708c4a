"""File > Import > TG4MM splats, and dropping such files into the 3D view."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from tg4mm.core.splatfile.drawable import Options, parsed_frequencies
from tg4mm.core.splatfile.read import ENDINGS

from .. import compat, names, preferences
from ..nodes import blending, clock, drawing, points, scene
from ..nodes.blending import true_colours
from ..nodes.shapes import DRAW_MODES, available
from ..panels import framing
from ..reporting import reports
from . import loading, splats


class IMPORT_SCENE_OT_tg4mm_splat(bpy.types.Operator, ImportHelper):
    """Import Gaussian splats with their motion as points that move"""

    bl_idname = "import_scene.tg4mm_splat"
    bl_label = "Import TG4MM Splats"
    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012

    filename_ext = ".ply"
    filter_glob: StringProperty(  # type: ignore[valid-type]
        default=";".join(f"*{ending}" for ending in ENDINGS), options={"HIDDEN"}
    )
    # SKIP_SAVE: else a file of the last import comes along with the next.
    files: CollectionProperty(  # type: ignore[valid-type]
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}
    )
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})  # type: ignore[valid-type]
    sequence: BoolProperty(  # type: ignore[valid-type]
        name="As Sequence",
        description="Numbered static files such as name_0001.ply, name_0002.ply play one after another; "
        "one of them brings its neighbours along",
        default=True,
    )
    timeline: BoolProperty(  # type: ignore[valid-type]
        name="Set Timeline",
        description="Take frame rate (Hz) and frame range from a file with motion, where nothing moves in the scene "
        "yet. The motion takes as long as it took at any frame rate",
        default=True,
    )
    colours: BoolProperty(  # type: ignore[valid-type]
        name="True Colours",
        description="Set the scene's view transform to Standard, as other splat viewers show the colours, and Cycles' "
        "transparent bounces high enough for splats",
        default=True,
    )
    show: BoolProperty(  # type: ignore[valid-type]
        name="Show",
        description="Frame what is imported in the 3D views, hide the startup scene's untouched cube where it is in "
        "the way, and leave Solid view for Material Preview, since Solid view shows splats grey",
        default=True,
    )
    axes: EnumProperty(  # type: ignore[valid-type]
        name="Up",
        description="Which way is up in the file; the object is turned so that it is up here",
        items=[
            (
                splats.CAMERAS,
                "By Its Cameras",
                "As SPZ and glTF, cameras.json or transforms.json beside it say, else Z up",
            ),
            (splats.FILE, "Z", "As Blender: nothing is turned"),
            (splats.MINUS_Y, "−Y", "As COLMAP and 3DGS have it"),
            (splats.PLUS_Y, "Y", "As other viewers and glTF have it"),
        ],
        default=splats.CAMERAS,
    )
    frequencies: StringProperty(  # type: ignore[valid-type]
        name="Frequencies",
        description="Hz, such as 5, 7.5: one for each mode of a file with motion that lost its line with them in "
        "another program. Without them it opens still",
        options={"SKIP_SAVE"},
    )
    most: IntProperty(  # type: ignore[valid-type]
        name="Most Gaussians",
        description="Refuse files with more Gaussians in all than this, before reading them",
        default=5_000_000,
        min=1,
    )

    def invoke(self, context: Any, event: Any) -> set[str]:
        if not self.properties.is_property_set("most"):
            self.most = preferences.get(context).most
        if self.directory and self.files:  # dropped into the view
            return self.execute(context)
        return ImportHelper.invoke(self, context, event)

    @reports("read")
    def execute(self, context: Any) -> set[str]:
        if context.mode != "OBJECT":  # else the object that is edited stays so, without being the active one
            bpy.ops.object.mode_set(mode="OBJECT")
        into = points.receiving(context)
        manager = context.window_manager
        manager.progress_begin(0, 100)
        try:
            loaded = loading.load(
                self._paths(),
                into,
                self.sequence,
                self.most,
                lambda part: manager.progress_update(int(100 * part)),
                Options(parsed_frequencies(self.frequencies), clock.rate(context.scene), blending.decode),
            )
        except MemoryError:
            self.report({"ERROR"}, f"{self._paths()[0]}: not enough memory for it")
            return {"CANCELLED"}
        finally:
            manager.progress_end()
        told = self._stand_up(loaded)
        for obj in loaded.objects:
            told += _draw_as(obj, preferences.get(context).draw_as)
        _select(context, loaded.objects)
        if self.show:
            told += framing.show(context, loaded.objects)
        message = "; ".join([loaded.message, *told, *self._set_up(context, loaded)])
        if into != context.collection:
            message += f"; in {into.name}, as {context.collection.name} is hidden or linked"
        self.report({"INFO"}, message)
        return {"FINISHED"}

    def _set_up(self, context: Any, loaded: loading.Loaded) -> list[str]:
        told = []
        if self.timeline:
            told.append(scene.set_timeline(context.scene, loaded.objects, loaded.fps, loaded.n_timesteps))
        if self.colours:
            told.append(true_colours(context.scene))
        return [words for words in told if words]

    def _stand_up(self, loaded: loading.Loaded) -> list[str]:
        """Rotate the objects so that the file's up axis is Z; return a message."""
        axes, said = self.axes, ""
        if axes == splats.CAMERAS and loaded.upright:
            return ["Y up, as the format has it, was turned to Z up"]
        if axes == splats.CAMERAS:
            axes, said = splats.told(self._paths()[0]) or (splats.FILE, "")
        if axes == splats.FILE:
            return []
        for obj in loaded.objects:
            obj.rotation_euler.x = splats.TURNS[axes]
            obj[names.AXES] = axes
        return [f"turned, as {said} says {splats.LABELS[axes]}"] if said else []

    def _paths(self) -> list[Path]:
        folder = Path(bpy.path.abspath(self.directory))
        chosen = [folder / file.name for file in self.files if file.name]
        return chosen or [Path(bpy.path.abspath(self.filepath))]


class IO_FH_tg4mm_splat(bpy.types.FileHandler):
    bl_idname = "IO_FH_tg4mm_splat"
    bl_label = "TG4MM Splats"
    bl_import_operator = IMPORT_SCENE_OT_tg4mm_splat.bl_idname
    bl_file_extensions = ";".join(ending for ending in ENDINGS if ending != ".json")

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}


def _draw_as(obj: Any, wanted: str) -> list[str]:
    """Apply the requested draw mode, or the best one for the object; return a message."""
    mesh = scene.first_mesh(obj)
    if wanted not in available(scene.moves(obj)):  # Automatic, or what this file has not
        wanted = drawing.best(len(mesh.vertices), len(obj[names.FREQUENCIES]))
    compat.set_input(scene.splat_modifier(obj), names.DRAW, wanted)
    far, span = drawing.far_out(mesh) if DRAW_MODES[wanted].native else (0, 0.0)
    return [f"{far:,} outliers span {span:.2g} times its size: all positions lose precision"] if far else []


def _select(context: Any, objects: list[Any]) -> None:
    """Make the imported object active but not selected: selection outlines would hide the splats' colours."""
    for other in (*context.selected_objects, *objects):
        other.select_set(False)
    context.view_layer.objects.active = objects[0]


def _menu(self: Any, context: Any) -> None:
    self.layout.operator(
        IMPORT_SCENE_OT_tg4mm_splat.bl_idname, text="TG4MM Splats (.ply, .splat, .spz, .sog, .glb)"
    )


def register() -> None:
    bpy.utils.register_class(IMPORT_SCENE_OT_tg4mm_splat)
    bpy.utils.register_class(IO_FH_tg4mm_splat)
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(IO_FH_tg4mm_splat)
    bpy.utils.unregister_class(IMPORT_SCENE_OT_tg4mm_splat)
