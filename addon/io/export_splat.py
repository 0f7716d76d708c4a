"""File > Export > TG4MM Splats: write an imported object, as edited, to splat files."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile, write_splat
from tg4mm.core.splatfile.spz import write_spz

from .. import names
from ..declare import reports
from ..nodes import scene
from . import splats

MOST_FILES = 10_000  # of a sequence; a frame range of more is a mistake
_WRITERS: dict[str, Callable[[Path, SplatFile], None]] = {".ply": write_splat, ".spz": write_spz}


class EXPORT_SCENE_OT_tg4mm_splat(bpy.types.Operator, ExportHelper):
    """Write the Gaussians of the active splat object, as they are in the world after cropping and transforming"""

    bl_idname = "export_scene.tg4mm_splat"
    bl_label = "Export TG4MM Splats"

    filename_ext = ".ply"
    check_extension = None  # set by `check`
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    filter_glob: StringProperty(default="*.ply;*.spz", options={"HIDDEN"})  # type: ignore[valid-type]
    content: EnumProperty(  # type: ignore[valid-type]
        name="Content",
        items=[
            ("MOTION", "Motion", "One PLY with the modes that are played; magnification stays a slider"),
            ("REST", "At Rest", "One file without motion, every Gaussian at its rest position"),
            ("NOW", "This Frame", "One file without motion, as the current frame shows it"),
            ("SEQUENCE", "Sequence", "A numbered file for each frame of the scene, as it shows it"),
        ],
    )
    format: EnumProperty(  # type: ignore[valid-type]
        name="Format",
        items=[
            (".ply", "PLY", "3DGS PLY, which every viewer of splats opens"),
            (".spz", "SPZ", "A tenth of the size, without motion; Y up, as the format requires"),
        ],
    )
    axes: EnumProperty(  # type: ignore[valid-type]
        name="Up",
        description="Which axis of a PLY points up",
        items=[
            ("IMPORTED", "As Imported", "As in the file that the object came from"),
            (splats.FILE, "Z", "As in Blender"),
            (splats.MINUS_Y, "−Y", "The convention of COLMAP and 3DGS"),
            (splats.PLUS_Y, "Y", "The convention of most viewers"),
        ],
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.splat_object(context) is not None

    def invoke(self, context: Any, event: Any) -> set[str]:
        if not self.filepath:
            self.filepath = bpy.path.clean_name(scene.splat_object(context).name) + self._suffix()
        return ExportHelper.invoke(self, context, event)

    def check(self, _context: Any) -> bool:
        wanted = bpy.path.ensure_ext(str(Path(self.filepath).with_suffix("")), self._suffix())
        changed, self.filepath = wanted != self.filepath, wanted
        return changed

    def draw(self, context: Any) -> None:
        self.layout.use_property_split = True
        self.layout.prop(self, "content")
        if self.content != "MOTION":
            self.layout.prop(self, "format")
        if self._suffix() == ".ply":
            self.layout.prop(self, "axes")

    @reports()
    def execute(self, context: Any) -> set[str]:
        obj, suffix = scene.splat_object(context), self._suffix()
        if context.mode != "OBJECT":  # the mesh of an object that is edited is an old one
            bpy.ops.object.mode_set(mode="OBJECT")
        path = Path(bpy.path.abspath(self.filepath)).with_suffix(suffix)
        axes = obj.get(names.AXES, splats.FILE) if self.axes == "IMPORTED" else self.axes
        axes = axes if suffix == ".ply" else splats.FILE  # SPZ turns by itself
        try:
            if self.content == "SEQUENCE":
                files = self._write_sequence(context, obj, path, axes)
                self.report(
                    {"INFO"}, f"Wrote {files} files, {path.stem}_0001{suffix} and so on, in {path.parent}"
                )
                return {"FINISHED"}
            splat = splats.splat_of(obj)
            still = self.content in ("REST", "NOW")
            if still:
                splat = (
                    splats.now(splat, obj, context.scene)
                    if self.content == "NOW"
                    else splats.without_motion(splat)
                )
            _WRITERS[suffix](path, splats.in_axes(splat, axes))
        except MemoryError:
            self.report({"ERROR"}, f"{path}: not enough memory to write it")
            return {"CANCELLED"}
        self.report(
            {"INFO"},
            f"Wrote {len(splat):,} Gaussians, {splat.n_modes} mode{'' if splat.n_modes == 1 else 's'}: {path}",
        )
        return {"FINISHED"}

    def _suffix(self) -> str:
        return ".ply" if self.content == "MOTION" else str(self.format)

    def _write_sequence(self, context: Any, obj: Any, path: Path, axes: str) -> int:
        """Write one file per frame and return the count. Raises Tg4mmError for bad input before anything is written."""
        first, last = context.scene.frame_start, context.scene.frame_end
        if last - first >= MOST_FILES:
            raise SplatFileError(
                f"frames {first} to {last} are {last - first + 1:,} files, more than {MOST_FILES:,}: shorten the range"
            )
        targets = [path.with_name(f"{path.stem}_{i + 1:04d}{path.suffix}") for i in range(last - first + 1)]
        wanted = {target.name for target in targets}
        if other := sorted(
            p.name for p in path.parent.glob(f"{path.stem}_*{path.suffix}") if p.name not in wanted
        ):
            raise SplatFileError(
                f"{path.parent}: holds {other[0]}, of another sequence of that name: choose another"
            )
        manager = context.window_manager
        manager.progress_begin(0, len(targets))
        for i, target in enumerate(_each_frame(context.scene, targets)):
            splat = splats.now(splats.splat_of(obj), obj, context.scene)
            _WRITERS[path.suffix](target, splats.in_axes(splat, axes))
            manager.progress_update(i)
        manager.progress_end()
        return len(targets)


def _each_frame(scene_: Any, targets: list[Path]) -> Iterator[Path]:
    """Yield a target path per scene frame, with the scene set to that frame."""
    before = scene_.frame_current, scene_.frame_subframe
    try:
        for i, target in enumerate(targets):
            scene_.frame_set(scene_.frame_start + i)
            yield target
    finally:
        scene_.frame_set(before[0], subframe=before[1])


def _menu(self: Any, context: Any) -> None:
    self.layout.operator(EXPORT_SCENE_OT_tg4mm_splat.bl_idname, text="TG4MM Splats (.ply, .spz)")


def register() -> None:
    bpy.utils.register_class(EXPORT_SCENE_OT_tg4mm_splat)
    bpy.types.TOPBAR_MT_file_export.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_export.remove(_menu)
    bpy.utils.unregister_class(EXPORT_SCENE_OT_tg4mm_splat)
